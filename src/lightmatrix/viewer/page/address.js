// The view as text for the address, so that it can be sent.

import { number } from "./packed.js";

// Milliseconds without a change after which the address is written: browsers refuse many writes.
const CALM = 200;
const NUMBERS = ["zoom", "x", "y", "exposure", "gamma"], MARKS = ["false", "marked"], SIDES = ["camera", "projector"];
let timer;

/** Write what the viewer shows into the address, soon. */
export function writeAddress(viewer) {
  clearTimeout(timer);
  timer = setTimeout(() => {
    const { field, shown, view } = viewer, { zoom, x, y } = view;
    const words = new URLSearchParams({ zoom: number(zoom), x: number(x), y: number(y), exposure: field.exposure.value, gamma: field.gamma.value });
    for (const name of MARKS) if (field[name].checked) words.set(name, "1");
    for (const side of SIDES) if (shown[side]) words.set(side, shown[side]);
    try { history.replaceState(null, "", `#${words}`); } catch { /* a sandboxed page keeps its address */ }
  }, CALM);
}

/** Show what the address says, as far as it makes sense. */
export function readAddress(viewer) {
  const words = new URLSearchParams(location.hash.slice(1)), numbers = {};
  for (const name of NUMBERS) if (words.has(name) && Number.isFinite(+words.get(name))) numbers[name] = +words.get(name);
  for (const name of ["exposure", "gamma"]) if (name in numbers) viewer.field[name].value = numbers[name];
  for (const name of MARKS) viewer.field[name].checked = words.get(name) === "1";
  viewer.setView({ zoom: numbers.zoom ?? 1, x: numbers.x ?? 0.5, y: numbers.y ?? 0.5 });
  for (const side of SIDES) if (viewer.scene.layers[words.get(side)]?.side === side) viewer.showLayer(side, words.get(side));
}
