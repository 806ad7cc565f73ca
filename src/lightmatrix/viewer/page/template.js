// The viewer's elements as HTML.

import { PRESETS } from "./pattern.js";

/** Tools: title, key and hint. */
export const TOOLS = {
  brush: ["Brush", "b", "Drag on the projector to paint."],
  eraser: ["Eraser", "e", "Drag on the projector to erase."],
  column: ["Column", "c", "Click a projector pixel to see what the camera sees of it alone."],
  ruler: ["Ruler", "r", "Drag on a picture to measure a distance in pixels."],
  move: ["Move", "m", "Drag a picture to move both."],
};
const KEYS = [
  ["Arrows", "move the pointer (with Shift, 8 pixels)"], ["Space", "paint a dot, or use the tool"],
  ["Enter", "put the brush down or lift it, so that arrows paint"], ["B E C R M", "choose a tool"],
  ["[ ]", "smaller or larger brush"], ["+ \u2212 0", "zoom, or fit"], ["Ctrl Z, Ctrl Y", "undo, redo"],
  ["I", "invert the pattern"], ["Esc", "leave a row or column"],
];

const pane = (side, title, hint) => `
  <section class="pane" data-side="${side}" aria-label="${title}">
    <header><h2>${title}</h2><label class="layer"><span class="hidden">Layer of the ${side}</span><select></select></label></header>
    <div class="stage" tabindex="0" role="application" aria-roledescription="picture" aria-label="${hint}">
      <canvas class="image" aria-hidden="true"></canvas><canvas class="marks" aria-hidden="true"></canvas>
    </div>
    <p class="readout"><span class="place">&nbsp;</span><span class="scale" hidden><span class="low"></span><canvas width="256" height="1" aria-hidden="true"></canvas><span class="high"></span><span class="unit"></span></span></p>
  </section>`;
const slider = (name, title, low, high, step, value) => `
  <label class="slider"><span>${title}</span><span class="value" data-of="${name}" aria-hidden="true"></span>
    <input type="range" name="${name}" aria-label="${title}" min="${low}" max="${high}" step="${step}" value="${value}"></label>`;
const tool = ([name, [title, key, hint]]) => `
  <label title="${hint} (${key.toUpperCase()})"><input type="radio" name="tool" value="${name}"${name === "brush" ? " checked" : ""}><span>${title}</span></label>`;

export const TEMPLATE = `
  <header class="bar"><h1></h1><p class="facts"></p><p class="notice" role="alert" hidden></p></header>
  <div class="panes">
    ${pane("projector", "Projector", "Projector. Arrow keys move the pointer, Space paints, Enter puts the brush down.")}
    ${pane("camera", "Camera", "Camera. Arrow keys move the pointer; the row of the camera pixel appears on the projector.")}
  </div>
  <form class="controls" autocomplete="off">
    <fieldset class="tools"><legend>Tool</legend>
      <div class="choice">${Object.entries(TOOLS).map(tool).join("")}</div>
      ${slider("size", "Size", 1, 64, 1, 8)}${slider("intensity", "Intensity", 0, 100, 1, 100)}
      <div class="row"><button type="button" name="undo">Undo</button><button type="button" name="redo">Redo</button></div></fieldset>
    <fieldset><legend>Pattern</legend>
      <div class="row"><label class="grow"><span class="hidden">Stored pattern</span><select name="preset"><option value="">Choose a pattern</option>
        ${Object.entries(PRESETS).map(([name, [title]]) => `<option value="${name}">${title}</option>`).join("")}</select></label></div>
      ${slider("period", "Period", 2, 64, 1, 16)}
      <div class="captured" hidden>${slider("frame", "Pattern of the capture", 0, 1, 1, 0)}</div>
      <div class="row"><button type="button" name="clear">Clear</button><button type="button" name="invert">Invert</button><button type="button" name="picture">Picture\u2026</button>
        <label class="check" hidden title="Project a picture so that the camera sees it as it is, whatever it falls on."><input type="checkbox" name="compensated"><span>Compensate pictures</span></label></div>
      <input type="file" accept="image/*" hidden aria-label="Picture for the projector"></fieldset>
    <fieldset><legend>Display</legend>
      ${slider("exposure", "Exposure", -8, 8, 0.05, 0)}${slider("gamma", "Gamma", 1, 4, 0.05, 2.2)}
      <div class="row"><label class="check"><input type="checkbox" name="false"><span>False colour</span></label>
        <label class="check"><input type="checkbox" name="marked"><span>Mark clipped</span></label>
        <label class="check" title="The scene as the projector sees it, behind the pattern."><input type="checkbox" name="behind"><span>Scene behind the pattern</span></label></div>
      <div class="row"><button type="button" name="auto">Auto exposure</button><span class="zooms"><button type="button" name="out" aria-label="Zoom out">\u2212</button><button type="button" name="fit">Fit</button><button type="button" name="in" aria-label="Zoom in">+</button></span></div></fieldset>
    <fieldset><legend>Files and keys</legend>
      <div class="row"><button type="button" name="snapshot">Save photograph</button><button type="button" name="save">Save pattern</button></div>
      <details><summary>Keyboard</summary><dl>${KEYS.map(([key, what]) => `<div><dt>${key}</dt><dd>${what}</dd></div>`).join("")}</dl></details></fieldset>
  </form>
  <p class="status" role="status"></p>`;
