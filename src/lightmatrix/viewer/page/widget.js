// The viewer as an output of a notebook: an anywidget.

import { Line } from "./line.js";
import { show } from "./show.js";

// Milliseconds without a change after which Python is told the pattern.
const RESTING = 200;

/** The kernel, through the widget's model. Several views of one widget do not disturb each other. */
class NotebookSource {
  #layers = new Map();
  #timer = null;
  #own = null;
  #rest = null;

  constructor(model) {
    this.model = model;
    // Not randomUUID(), which notebooks served without encryption lack.
    this.view = crypto.getRandomValues(new Uint32Array(4)).join("-");
    this.line = new Line((message) => model.send({ view: this.view, what: "message" }, undefined, [message.buffer]));
    this.listener = (content, buffers) => { if (content.view === this.view) this.#receive(content, bytesOf(buffers[0])); };
    model.on("msg:custom", this.listener);
  }

  async scene() { return bytesOf(this.model.get("description")); }
  async matrix() { return bytesOf(this.model.get("matrix")); }

  layer(name) {
    this.model.send({ view: this.view, what: "layer", name });
    return new Promise((done, failed) => this.#layers.set(name, { done, failed }));
  }

  #receive(content, buffer) {
    if (content.what === "layer") {
      const { done, failed } = this.#layers.get(content.name);
      if (content.error) failed(new Error(content.error));
      else done(buffer);
      return;
    }
    this.line.receive(buffer);
    // The kernel sends the rest part by part, so that it can do other work in between.
    clearTimeout(this.#rest);
    if (content.more) this.#rest = setTimeout(() => this.model.send({ view: this.view, what: "finish" }), content.wait);
  }

  watch(viewer) {
    this.take = () => {
      const levels = this.model.get("levels");
      // What this view has set itself needs no drawing.
      if (levels === this.#own || levels.byteLength !== viewer.pattern.levels.length) return;
      viewer.pattern.set(new Uint8Array(bytesOf(levels)));
      viewer.change();
    };
    this.model.on("change:levels", this.take);
    if (this.model.get("levels").byteLength) this.take();
    else this.keep(viewer.pattern.levels);
  }

  /** Tell Python the pattern, when it rests. */
  keep(levels) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      this.#own = new DataView(levels.slice().buffer);
      this.model.set("levels", this.#own);
      this.model.save_changes();
    }, RESTING);
  }

  close() {
    clearTimeout(this.#timer);
    clearTimeout(this.#rest);
    this.model.off("msg:custom", this.listener);
    this.model.off("change:levels", this.take);
  }
}

/** A copy of the bytes of a DataView, aligned as typed arrays need them. */
const bytesOf = (view) => view && view.buffer.slice(view.byteOffset, view.byteOffset + view.byteLength);

/** Show the viewer in an output cell (anywidget calls it). */
async function render({ model, el }) {
  const root = document.createElement("div");
  el.append(root);
  const source = new NotebookSource(model);
  el.viewer = await show(root, source);
  return () => source.close();
}

export default { render };
