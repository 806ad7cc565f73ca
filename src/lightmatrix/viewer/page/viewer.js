// The viewer: holds what is shown, and connects panes, tools, fields and T.

import { readAddress, writeAddress } from "./address.js";
import { download, greyImage, readGrey } from "./files.js";
import { contentOf, Layers } from "./layers.js";
import { KIND } from "./line.js";
import { Pane } from "./panes.js";
import { Pattern, PRESETS } from "./pattern.js";
import { Pointing, shortcut, ZOOM } from "./pointing.js";
import { TEMPLATE, TOOLS } from "./template.js";

// The strongest magnification, and the last strokes whose times are kept.
const MOST_ZOOM = 64, RECENT = 512;
const NO_OVERLAYS = { projector: null, camera: null };

export class Viewer {
  view = { zoom: 1, x: 0.5, y: 0.5 };
  /** The layer of each side; "" for the pattern and for the relit image. */
  shown = { projector: "", camera: "" };
  /** A row or column of T above the layer. */
  overlay = { ...NO_OVERLAYS };
  /** Milliseconds from a movement of the brush to the frame that shows its light. */
  latencies = [];
  /** When the first movement happened that is not relit, and one that is relit but not drawn. */
  #moved = null;
  #relit = null;
  /** The picture that is projected, to compensate it later; whether a pattern of the capture is. */
  #file = null;
  #framed = false;
  #changed = false;
  #waiting = false;

  constructor(root, source, scene, matrix) {
    Object.assign(this, { root, source, matrix, scene: scene.header, colours: scene.arrays });
    root.classList.add("lightmatrix-viewer");
    root.innerHTML = TEMPLATE;
    const { camera, projector } = this.scene;
    this.channels = camera[2] ?? 1;
    this.sizes = { projector, camera: camera.slice(0, 2) };
    this.pattern = new Pattern(projector);
    this.layers = new Layers(source, this.scene.layers);
    this.pointing = new Pointing(this);
    this.form = root.querySelector("form");
    this.field = Object.fromEntries([...this.form.elements].filter((field) => field.name && field.type !== "radio").map((field) => [field.name, field]));
    this.panes = {};
    for (const element of root.querySelectorAll(".pane")) this.#addPane(element);
    this.#fillIn();
    this.#listen();
    if (source.keepsAddress) readAddress(this);
    this.pattern.begin();
    matrix.onrelit = (time) => { this.#relit ??= time; this.redraw(); };
    matrix.onerror = (message) => this.notice(message);
    new ResizeObserver(() => this.redraw()).observe(root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    // For a matrix that stays in Python, this picture takes a pass over all of it.
    this.field.behind.checked = !matrix.remote;
    this.#input("behind");
    this.change();
  }

  /** The camera image under the pattern, as far as it is relit. */
  get photograph() { return this.matrix.photograph; }
  get tool() { return this.form.elements.tool.value; }
  get gain() { return 2 ** +this.field.exposure.value; }

  // --- elements ---

  #addPane(element) {
    const pane = new Pane(element, this.sizes[element.dataset.side]), { side, select } = pane;
    this.panes[side] = pane;
    pane.picture.onrestored = () => this.redraw();
    const own = new Option(side === "projector" ? "Pattern" : "Relit", "");
    select.replaceChildren(own, ...this.layers.of(side).map(([name, layer]) => new Option(layer.title, name)));
    select.addEventListener("change", () => this.showLayer(side, select.value));
    this.pointing.listen(pane);
  }

  /** Title, facts and the ranges of the fields, which depend on the scene. */
  #fillIn() {
    const { field, sizes, channels, scene } = this, longest = Math.max(...sizes.projector);
    const colours = channels > 1 ? `, ${channels} channels` : "";
    this.root.querySelector("h1").textContent = scene.title;
    this.root.querySelector(".facts").textContent = `projector ${sizes.projector.join(" \u00d7 ")}, camera ${sizes.camera.join(" \u00d7 ")}${colours}`;
    field.size.max = Math.max(8, Math.ceil(longest / 2));
    field.size.value = Math.max(1, Math.round(longest / 12));
    field.period.max = Math.max(4, Math.ceil(longest / 2));
    field.period.value = Math.max(2, Math.round(longest / 8));
    field.exposure.value = Math.log2(1 / this.matrix.white);
    field.frame.max = Math.max(0, (scene.frames ?? 0) - 1);
    this.root.querySelector(".captured").hidden = !scene.frames;
    field.compensated.closest("label").hidden = !scene.compensates || !this.source.line;
  }

  #listen() {
    const { field, form, root } = this, file = form.querySelector("[type=file]");
    const buttons = {
      undo: () => this.undo(), redo: () => this.redo(),
      clear: () => this.fill(() => 0), invert: () => this.invert(), picture: () => file.click(),
      auto: () => this.autoExposure(), out: () => this.zoom(1 / ZOOM), in: () => this.zoom(ZOOM), fit: () => this.fit(),
      snapshot: () => download(this.snapshot(), "photograph"), save: () => download(this.patternImage(), "pattern"),
    };
    for (const [name, action] of Object.entries(buttons)) field[name].addEventListener("click", action);
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", (event) => this.#input(event.target.name));
    file.addEventListener("change", () => { this.usePicture(file.files[0]); file.value = ""; });
    root.addEventListener("dragover", (event) => { event.preventDefault(); root.classList.add("dropping"); });
    root.addEventListener("dragleave", (event) => { if (!root.contains(event.relatedTarget)) root.classList.remove("dropping"); });
    root.addEventListener("drop", (event) => { event.preventDefault(); root.classList.remove("dropping"); this.usePicture(event.dataTransfer.files[0]); });
    root.addEventListener("keydown", (event) => shortcut(this, event));
  }

  #input(name) {
    if (name === "preset" || name === "period") {
      const preset = PRESETS[this.field.preset.value];
      if (preset && (name === "preset" || preset[1].length)) this.fill(preset[1](+this.field.period.value, this.pattern.rows, this.pattern.cols));
    }
    if (name === "compensated") {
      if (this.#file) this.usePicture(this.#file);
      else if (this.field.compensated.checked) this.say("Choose a picture: the camera will see it as it is.");
    }
    if (name === "behind") this.#fetchBehind();
    if (name === "frame") this.useFrame(+this.field.frame.value);
    if (name === "tool") { this.pointing.ruler = null; this.#clearOverlays(); this.say(TOOLS[this.tool][2]); }
    this.#showValues();
    this.redraw();
    this.#writeAddress();
  }

  setTool(tool) {
    this.form.elements.tool.value = tool;
    this.pointing.lift();
    this.#input("tool");
  }

  setSize(size) {
    this.field.size.value = size;
    this.#input("size");
    this.say(`Brush of ${this.field.size.value} px`);
  }

  escape() {
    this.pointing.lift();
    this.pointing.ruler = null;
    this.#clearOverlays();
  }

  #showValues() {
    const { field } = this;
    const texts = {
      size: `${field.size.value} px`, intensity: `${field.intensity.value} %`, period: `${field.period.value} px`,
      frame: this.#framed ? `${+field.frame.value + 1} of ${this.scene.frames ?? 0}` : "not shown",
      exposure: `\u00d7 ${(+this.gain.toPrecision(3)).toString()}`, gamma: (+field.gamma.value).toFixed(2).replace(/\.?0+$/, ""),
    };
    for (const [name, text] of Object.entries(texts)) {
      this.form.querySelector(`[data-of=${name}]`).textContent = text;
      field[name].setAttribute("aria-valuetext", text);
    }
    field.undo.disabled = this.pattern.past.length === 0;
    field.redo.disabled = this.pattern.future.length === 0;
  }

  say(text) { this.root.querySelector(".status").textContent = text; }

  /** Tell what the user must know, until it is over (text ""). */
  notice(text) {
    const place = this.root.querySelector(".notice");
    place.textContent = text;
    place.hidden = !text;
  }

  // --- the pattern and the photograph ---

  fill(level) { this.#own(); this.pattern.fill(level); this.change(); }
  undo() { if (this.pattern.undo()) { this.#own(); this.change(); } }
  redo() { if (this.pattern.redo()) { this.#own(); this.change(); } }
  invert() { this.#own(); this.pattern.invert(); this.change(); }
  /** The pattern is neither a picture of the user nor one of the capture any more. */
  #own() { this.#file = null; this.#framed = false; }

  /** Move the brush from one place to another; `first` where it is put down. */
  paint(from, to, level, first, time) {
    if (first) {
      this.#own();
      this.pattern.keep();
      this.overlay = { ...NO_OVERLAYS };
      for (const side of ["projector", "camera"]) if (this.shown[side]) this.showLayer(side, "");
    }
    this.pattern.stroke(from, to, +this.field.size.value, level);
    this.#moved ??= time;
    this.change();
  }

  /** A stroke is done. */
  painted() { this.#showValues(); }

  /** Show a picture on the projector, or make the camera see it. */
  async usePicture(file) {
    if (!file) return;
    const compensated = this.field.compensated.checked, [rows, cols] = this.sizes[compensated ? "camera" : "projector"];
    let levels, words;
    try { ({ levels, words } = await readGrey(file, rows, cols)); } catch { this.notice(`${file.name} is not a picture that this browser can read. PNG and JPEG work.`); return; }
    this.notice("");
    this.#own();
    this.#file = file;
    if (!compensated) { this.pattern.set(levels); this.change(); this.say(words); return; }
    this.say("Computing the pattern\u2026");
    try {
      const { header, arrays } = await this.source.line.ask(KIND.compensate, [], levels);
      this.pattern.set(arrays.levels);
      this.change();
      this.say(`${words} ${header.words}`);
    } catch (error) { this.say(""); this.notice(error.message); }
  }

  /** Show a pattern of the capture. */
  async useFrame(number) {
    try {
      const { arrays } = await this.source.frame(number);
      // Another one was chosen meanwhile.
      if (number !== +this.field.frame.value) return;
      this.#own();
      this.#framed = true;
      this.pattern.set(arrays.levels);
      this.change();
    } catch (error) { this.notice(error.message); }
  }

  /** The pattern changed: relight what changed, and draw both panes with the next frame. */
  change() {
    this.#changed = true;
    this.#showValues();
    // A question is asked at once, as its answer may be there before the next frame.
    if (this.matrix.remote) this.relight();
    this.redraw();
    this.source.keep?.(this.pattern.levels);
  }

  /** Bring the photograph up to date with the pattern, or ask for it. */
  relight() {
    const time = this.#moved;
    this.#changed = false;
    this.#moved = null;
    // Not within ??=, which would not relight while a picture waits to be drawn.
    const relit = this.matrix.relight(this.pattern.levels, time);
    this.#relit ??= relit;
  }

  // --- layers, rows and columns ---

  async showLayer(side, name) {
    this.#clearOverlays();
    if (name && !this.layers.get(name)) {
      this.say("Computing the layer\u2026");
      try { await this.layers.fetch(name); } catch (error) {
        this.notice(error.message);
        this.panes[side].select.value = this.shown[side];
        return;
      } finally { this.say(""); }
    }
    this.shown[side] = name;
    this.panes[side].select.value = name;
    this.redraw();
    this.#writeAddress();
  }

  /** The scene as the projector sees it, behind the pattern; only asked for once it is wanted. */
  async #fetchBehind() {
    const { behind } = this.field, [rows, cols] = this.sizes.projector;
    if (!behind.checked || this.layers.behind) return;
    try { await this.layers.fetchBehind(rows * cols); } catch { behind.checked = false; }
    this.redraw();
  }

  /** Show the row of a camera pixel on the projector. */
  showRow(row, col) { this.matrix.row(row, col, (values) => this.#overlay("projector", values, `Row of camera pixel ${row}, ${col}`)); }

  /** Show the column of a projector pixel in the camera. */
  showColumn(row, col) { this.matrix.column(row, col, (values) => this.#overlay("camera", values, `Column of projector pixel ${row}, ${col}`)); }

  leaveRow() { this.matrix.forget?.(); this.overlay.projector = null; }

  #overlay(side, values, title) { this.overlay[side] = { values, title }; this.redraw(); }

  #clearOverlays() { this.matrix.forget?.(); this.overlay = { ...NO_OVERLAYS }; this.redraw(); }

  content(side) { return contentOf(this, side); }

  // --- drawing and view ---

  redraw() {
    if (this.#waiting) return;
    this.#waiting = true;
    requestAnimationFrame(() => this.#frame());
  }

  #frame() {
    this.#waiting = false;
    // Two frames, of the pattern and then of its light, would take twice as long. Light that has come is
    // drawn even if more is on its way, or a long stroke would show nothing until it ends.
    if (this.#relit === null && this.matrix.expects) { this.redraw(); return; }
    if (this.#changed) this.relight();
    this.#drawNow();
  }

  #drawNow() {
    const paper = getComputedStyle(this.root).getPropertyValue("--stage").trim();
    const colour = [1, 3, 5].map((start) => parseInt(paper.slice(start, start + 2), 16) / 255);
    for (const [side, pane] of Object.entries(this.panes)) pane.draw(this.content(side), this.view, colour, this.pointing.marks(side));
    if (this.#relit === null) return;
    this.latencies.push(performance.now() - this.#relit);
    if (this.latencies.length > RECENT) this.latencies.shift();
    this.#relit = null;
  }

  zoom(factor, at = { x: this.view.x, y: this.view.y }) {
    const zoom = within(1, this.view.zoom * factor, MOST_ZOOM), share = this.view.zoom / zoom;
    this.setView({ zoom, x: at.x + (this.view.x - at.x) * share, y: at.y + (this.view.y - at.y) * share });
  }

  fit() { this.setView({ zoom: 1, x: 0.5, y: 0.5 }); }

  setView({ zoom, x, y }) {
    const magnified = within(1, zoom, MOST_ZOOM), edge = 0.5 / magnified;
    this.view = { zoom: magnified, x: within(edge, x, 1 - edge), y: within(edge, y, 1 - edge) };
    this.redraw();
    this.#writeAddress();
  }

  #writeAddress() { if (this.source.keepsAddress) writeAddress(this); }

  autoExposure() {
    const sorted = Float64Array.from(this.photograph).sort();
    const white = sorted[Math.floor(0.995 * (sorted.length - 1))];
    if (white > 0) this.field.exposure.value = Math.log2(1 / white);
    this.#input("exposure");
  }

  /** What the camera pane shows, one pixel for each of the camera's. */
  snapshot() {
    if (this.#changed) this.relight();
    this.#drawNow();
    return this.panes.camera.picture.pixels(this.panes.camera.look);
  }

  /** The pattern, one pixel for each of the projector's. */
  patternImage() { return greyImage(this.pattern.levels, this.pattern.rows, this.pattern.cols); }
}

const within = (low, value, high) => Math.min(high, Math.max(low, value));
