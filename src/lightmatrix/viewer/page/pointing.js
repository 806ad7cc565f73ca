// The pointer, of the mouse, a pen, a finger or the keyboard: what tools do where it points.

import { number } from "./packed.js";
import { TOOLS } from "./template.js";

const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
// Pixels of an arrow with Shift, and the factor of a key or button that zooms.
const FAR = 8;
export const ZOOM = 1.5;

export class Pointing {
  /** Places of the pointer on both sides; null where it is elsewhere. */
  spots = { projector: null, camera: null };
  ruler = null;
  /** A button is down: where, since when, and whether it moves the pictures. */
  #drag = null;
  /** The keyboard has put the tool down. */
  #down = false;
  #last = null;

  constructor(viewer) { this.viewer = viewer; }

  listen(pane) {
    const { stage } = pane, { viewer } = this;
    stage.addEventListener("pointerdown", (event) => this.#press(pane, event));
    stage.addEventListener("pointermove", (event) => this.#move(pane, event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) stage.addEventListener(kind, () => this.#release());
    stage.addEventListener("pointerleave", () => this.#leave(pane));
    stage.addEventListener("wheel", (event) => {
      event.preventDefault();
      // A wheel that counts lines moves fewer of them than one that counts pixels.
      viewer.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), pane.share(event));
    }, { passive: false });
    stage.addEventListener("keydown", (event) => this.#key(pane, event));
    stage.addEventListener("blur", () => { if (!stage.matches(":hover")) this.#leave(pane); });
  }

  /** What is marked on a side. */
  marks(side) {
    const { viewer } = this;
    const brush = side === "projector" && paints(viewer.tool) ? +viewer.field.size.value : 0;
    return { pointer: this.spots[side], brush, ruler: this.ruler?.side === side ? this.ruler : null };
  }

  lift() { this.#down = false; }

  #press(pane, event) {
    if (!pane.at || (event.button !== 0 && event.button !== 1)) return;
    const { viewer } = this;
    pane.stage.setPointerCapture(event.pointerId);
    const spot = pane.spot(event), moving = viewer.tool === "move" || event.button === 1;
    this.#drag = { pane, last: spot, moving, view: { ...viewer.view }, start: [event.clientX, event.clientY] };
    if (!moving) this.#use(pane, spot, true, event.timeStamp);
    event.preventDefault();
    pane.stage.focus({ preventScroll: true, focusVisible: false });
  }

  #move(pane, event) {
    if (!pane.at) return;
    const drag = this.#drag?.pane === pane ? this.#drag : null;
    // Browsers join the movements of one frame; a fast stroke needs all of them.
    const events = drag && event.getCoalescedEvents ? event.getCoalescedEvents() : [];
    for (const one of events.length ? events : [event]) {
      const spot = pane.spot(one);
      if (drag?.moving) this.#pan(pane, drag, one);
      else if (drag) this.#use(pane, spot, false, one.timeStamp);
      this.#point(pane, spot);
    }
  }

  #pan(pane, { view, start }, event) {
    const share = pane.picture.canvas.width / pane.stage.clientWidth / pane.at.scale, [rows, cols] = pane.size;
    this.viewer.setView({
      zoom: this.viewer.view.zoom,
      x: view.x - (event.clientX - start[0]) * share / cols,
      y: view.y - (event.clientY - start[1]) * share / rows,
    });
  }

  #release() {
    if (this.#drag && !this.#drag.moving) this.viewer.painted();
    this.#drag = null;
  }

  /** Use the tool at a place; `first` when it is put down. */
  #use(pane, spot, first, time) {
    const { viewer } = this, { tool } = viewer;
    if (tool === "ruler") this.#measure(pane.side, spot, first);
    else if (pane.side === "projector" && tool === "column") {
      if (pane.inside(spot)) viewer.showColumn(...spot.map(Math.floor));
    } else if (pane.side === "projector" && paints(tool)) {
      const level = tool === "eraser" ? 0 : Math.round(2.55 * viewer.field.intensity.value);
      const from = first ? spot : this.#drag?.last ?? this.#last ?? spot;
      viewer.paint(from, spot, level, first, time);
    }
    if (this.#drag) this.#drag.last = spot;
    this.#last = spot;
    viewer.redraw();
  }

  #measure(side, spot, first) {
    this.ruler = { side, from: first ? spot : this.ruler.from, to: spot };
    const [row, col] = [0, 1].map((k) => spot[k] - this.ruler.from[k]);
    this.ruler.length = `${Math.hypot(row, col).toFixed(1)} px`;
    this.viewer.say(`${this.ruler.length} (${Math.abs(row).toFixed(1)} down, ${Math.abs(col).toFixed(1)} across)`);
  }

  /** The pointer is at a place: mark it and tell its value. */
  #point(pane, spot) {
    const { viewer } = this, { side, place } = pane, [row, col] = spot.map(Math.floor);
    const inside = pane.inside(spot);
    this.spots[side] = inside || side === "projector" ? spot : null;
    if (!inside) return this.#nowhere(pane);
    const reads = side === "camera" && !this.#drag && viewer.tool !== "ruler" && viewer.tool !== "move";
    if (reads && !viewer.overlay.camera) viewer.showRow(row, col);
    const { values, channels } = viewer.content(side), start = (row * pane.size[1] + col) * channels;
    const white = values === viewer.pattern.levels ? 255 : 1;
    const shown = Array.from(values.slice(start, start + channels), (value) => number(value / white));
    place.textContent = `row ${row}, column ${col}: ${shown.join(" ")}`;
    viewer.redraw();
  }

  #leave(pane) {
    if (this.#drag) return;
    this.spots[pane.side] = null;
    this.#nowhere(pane);
  }

  /** The pointer is on no pixel of this side. */
  #nowhere(pane) {
    pane.place.textContent = "\u00a0";
    if (pane.side === "camera") this.viewer.leaveRow();
    this.viewer.redraw();
  }

  #key(pane, event) {
    const steps = ARROWS[event.key], [rows, cols] = pane.size, { viewer } = this;
    const middle = [Math.floor(rows / 2) + 0.5, Math.floor(cols / 2) + 0.5], at = this.spots[pane.side] ?? middle;
    if (steps && !event.ctrlKey && !event.metaKey && !event.altKey) {
      const far = event.shiftKey ? FAR : 1;
      const spot = [0, 1].map((k) => Math.min(pane.size[k] - 0.5, Math.max(0.5, Math.floor(at[k]) + 0.5 + far * steps[k])));
      this.#last = at;
      if (this.#down) this.#use(pane, spot, false, event.timeStamp);
      this.#point(pane, spot);
      viewer.say(pane.place.textContent);
    } else if (event.key === " ") {
      this.#use(pane, at, true, event.timeStamp);
      this.#point(pane, at);
    } else if (event.key === "Enter") {
      this.#down = !this.#down;
      if (this.#down) this.#use(pane, at, true, event.timeStamp);
      viewer.say(this.#down ? "The tool is down: arrows use it." : "The tool is lifted.");
    } else return;
    event.preventDefault();
  }
}

const paints = (tool) => tool === "brush" || tool === "eraser";

/** Keys that work wherever the focus is within the viewer. */
export function shortcut(viewer, event) {
  const { field } = viewer, key = event.key.toLowerCase();
  if (event.ctrlKey || event.metaKey) {
    if (key === "z") (event.shiftKey ? field.redo : field.undo).click();
    else if (key === "y") field.redo.click();
    else return;
    event.preventDefault();
    return;
  }
  const typing = event.target.matches?.("select, input:not([type=radio]):not([type=checkbox]):not([type=range])");
  if (typing || event.altKey) return;
  const tool = Object.entries(TOOLS).find(([, [, letter]]) => letter === key)?.[0];
  if (tool) viewer.setTool(tool);
  else if (key === "[" || key === "]") viewer.setSize(+field.size.value + (key === "]" ? 1 : -1));
  else if (key === "+" || key === "=") viewer.zoom(ZOOM);
  else if (key === "-") viewer.zoom(1 / ZOOM);
  else if (key === "0") viewer.fit();
  else if (key === "i") viewer.invert();
  else if (key === "escape") viewer.escape();
  else return;
  event.preventDefault();
}
