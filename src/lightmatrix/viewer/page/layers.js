// What a pane shows: its own image, a layer, or a row or column of T.

import { unpack } from "./packed.js";

// A row or column is drawn with this power of its values, which makes faint light visible; as in
// lightmatrix.pictures.transport.
const FAINT = 1 / 0.35;

/** The layers of both sides, which are fetched when they are first shown. */
export class Layers {
  #fetched = {};

  constructor(source, available) { Object.assign(this, { source, available }); }

  of(side) { return Object.entries(this.available).filter(([, layer]) => layer.side === side); }

  get(name) { return this.#fetched[name]; }

  async fetch(name) { this.#fetched[name] ??= unpack(await this.source.layer(name)); }

  /** Fetch the scene as the projector sees it: grey levels that lie behind the pattern. */
  async fetchBehind(pixels) {
    await this.fetch("dual");
    const { header, arrays: { values } } = this.get("dual"), channels = values.length / pixels;
    const behind = new Uint8Array(pixels);
    for (let k = 0; k < pixels; k++) {
      let light = 0;
      for (let channel = 0; channel < channels; channel++) light += values[k * channels + channel];
      behind[k] = 255 * Math.min(1, Math.max(0, light / channels / header.white)) ** (1 / 2.2);
    }
    this.behind = behind;
  }
}

/** What a pane shows now, and how: values, channels, look and the words for its scale. */
export function contentOf(viewer, side) {
  const overlay = viewer.overlay[side], layer = viewer.layers.get(viewer.shown[side]);
  if (overlay) return overlayContent(viewer, side, overlay);
  if (layer) return layerContent(viewer, side, layer);
  if (side === "projector") return { values: viewer.pattern.levels, channels: 1, look: { gain: 1 / 255, behind: viewer.field.behind.checked && viewer.layers.behind } };
  const { matrix, field, channels, gain } = viewer, values = matrix.photograph;
  const look = { gain, gamma: +field.gamma.value, marked: field.marked.checked };
  if (!field.false.checked) return { values, channels, look };
  return { values, channels, look: { ...look, colours: viewer.colours.false }, label: "of full scale", top: 1 / gain };
}

function overlayContent(viewer, side, { values, title }) {
  const high = Math.max(values.reduce((most, value) => Math.max(most, value), 0), 1e-12);
  const look = { colours: viewer.colours.faint, low: 0, high, gamma: FAINT };
  return { values, channels: side === "camera" ? viewer.channels : 1, look, label: title };
}

function layerContent(viewer, side, { header, arrays: { values, colours } }) {
  const [rows, cols] = viewer.sizes[side];
  if (header.white) {
    // Light, such as the dual image.
    const look = { gain: header.gained ? viewer.gain : 1 / header.white, gamma: +viewer.field.gamma.value };
    return { values, channels: values.length / rows / cols, look };
  }
  const { low, high, logarithmic } = header;
  return { values, channels: 1, look: { colours, low, high, logarithmic }, label: header.label };
}
