// The viewer of lightmatrix: paint on the projector, and see what the camera would photograph.
//
// One module without a build and without requests other than to its own source. Its parts:
//   numbers   unpack(), Matrix: T in the page, relit stroke by stroke
//   pattern   Pattern: what the projector shows, with undo
//   pictures  Picture: a canvas with WebGL2 that draws an image with exposure, gamma and colours
//   controls  Viewer: panes, tools, keyboard, address
//   sources   where scene, matrix and layers come from: a server, the page itself, a notebook
// Pixels are numbered in the order (row, column), camera samples in the order (row, column, channel).

const MAGIC = "LMVIEW1\n";
const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f2: Uint16Array, f4: Float32Array };

/** The header and the arrays that the server packed (packed.py). */
export function unpack(buffer) {
  const decoder = new TextDecoder();
  if (decoder.decode(new Uint8Array(buffer, 0, MAGIC.length)) !== MAGIC) throw new Error("The data is not for this viewer.");
  const start = MAGIC.length + 4;
  const length = new DataView(buffer).getUint32(MAGIC.length, true);
  const header = JSON.parse(decoder.decode(new Uint8Array(buffer, start, length)));
  const arrays = {};
  for (const [name, { type, count, offset }] of Object.entries(header.arrays)) {
    arrays[name] = new TYPES[type](buffer, start + length + offset, count);
  }
  return { header, arrays };
}

/** All 65,536 numbers of half precision, times a factor. */
function halves(scale) {
  const table = new Float64Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const exponent = (bits >> 10) & 31, fraction = bits & 1023;
    const size = exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25);
    table[bits] = (bits & 32768 ? -size : size) * scale;
  }
  return table;
}

/** T = S + B m in the page: S column by column, B cell by cell. */
export class Matrix {
  constructor({ header, arrays }, scene) {
    this.samples = scene.camera.reduce((product, size) => product * size);
    this.pixels = scene.projector[0] * scene.projector[1];
    Object.assign(this, { ends: arrays.ends, rows: arrays.rows, values: arrays.values, white: header.white });
    this.table = halves(header.value_scale);
    const cells = scene.grid[0] * scene.grid[1];
    const table = halves(header.background_scale);
    this.background = Float32Array.from(arrays.background, (bits) => table[bits]);
    this.lit = this.background.some((value) => value !== 0) ? cells : 0;
    this.cellOf = gridCells(scene.projector, scene.grid);
    this.cellSize = new Float64Array(cells);
    for (const cell of this.cellOf) this.cellSize[cell] += 1;
  }

  /** Add to an image the light of some projector pixels; change() says how much brighter each gets. */
  add(image, pixels, change) {
    const { ends, rows, values, table, cellOf } = this;
    const means = new Float64Array(this.cellSize.length);
    for (const pixel of pixels) {
      const amount = change(pixel);
      if (amount === 0) continue;
      for (let k = ends[pixel], end = ends[pixel + 1]; k < end; k++) image[rows[k]] += amount * table[values[k]];
      means[cellOf[pixel]] += amount / this.cellSize[cellOf[pixel]];
    }
    for (let cell = 0; cell < this.lit; cell++) {
      if (means[cell] === 0) continue;
      const start = cell * this.samples;
      for (let i = 0; i < this.samples; i++) image[i] += means[cell] * this.background[start + i];
    }
  }

  /** The camera image under the levels of a pattern, computed from nothing. */
  relight(levels) {
    const image = new Float64Array(this.samples);
    this.add(image, levels.keys(), (pixel) => levels[pixel] / 255);
    return image;
  }

  /** A column of T: what the camera sees of one projector pixel. */
  column(pixel) {
    const image = new Float64Array(this.samples);
    this.add(image, [pixel], () => 1);
    return image;
  }

  /** The row of one camera pixel, its channels added: how much each projector pixel lights it. */
  row(first, channels) {
    const { ends, rows, values, table } = this;
    const image = new Float64Array(this.pixels);
    for (let sample = first; sample < first + channels; sample++) {
      for (let pixel = 0; pixel < this.pixels; pixel++) {
        // The entries of a column are sorted by row.
        let low = ends[pixel], high = ends[pixel + 1];
        while (low < high) {
          const middle = (low + high) >> 1;
          if (rows[middle] < sample) low = middle + 1;
          else high = middle;
        }
        if (low < ends[pixel + 1] && rows[low] === sample) image[pixel] += table[values[low]];
        if (this.lit) image[pixel] += this.background[this.cellOf[pixel] * this.samples + sample] / this.cellSize[this.cellOf[pixel]];
      }
    }
    return image;
  }
}

/** The cell of the background's grid that each projector pixel lies in. */
function gridCells([rows, cols], [down, across]) {
  const cells = new Uint32Array(rows * cols);
  for (let row = 0, k = 0; row < rows; row++) {
    for (let col = 0; col < cols; col++, k++) {
      cells[k] = Math.floor((row * down) / rows) * across + Math.floor((col * across) / cols);
    }
  }
  return cells;
}

// Patterns that can be undone. Each keeps one byte a pixel, so large projectors keep fewer.
const UNDO_BYTES = 64 << 20, MOST_UNDOS = 200;

/** What the projector shows: 8-bit levels, with undo and redo. */
export class Pattern {
  constructor([rows, cols]) {
    Object.assign(this, { rows, cols, levels: new Uint8Array(rows * cols), past: [], future: [] });
    this.most = Math.max(5, Math.min(MOST_UNDOS, Math.floor(UNDO_BYTES / (rows * cols))));
  }

  /** Keep the levels, so that undo returns to them. */
  keep() {
    this.past.push(this.levels.slice());
    if (this.past.length > this.most) this.past.shift();
    this.future = [];
  }

  undo() { return this.#step(this.past, this.future); }
  redo() { return this.#step(this.future, this.past); }
  #step(from, to) {
    if (from.length === 0) return false;
    to.push(this.levels.slice());
    this.levels.set(from.pop());
    return true;
  }

  /** Give all pixels the level of a function of (row, column), 0 to 1. */
  fill(level) {
    this.keep();
    for (let row = 0, k = 0; row < this.rows; row++) {
      for (let col = 0; col < this.cols; col++, k++) this.levels[k] = Math.round(255 * level(row, col));
    }
  }

  /** Paint every pixel whose centre lies within a brush that moved from one place to another. */
  stroke([row0, col0], [row1, col1], diameter, level) {
    const radius = Math.max(diameter / 2, 0.5);
    const dr = row1 - row0, dc = col1 - col0, length = dr * dr + dc * dc;
    const top = Math.max(0, Math.floor(Math.min(row0, row1) - radius)), bottom = Math.min(this.rows - 1, Math.ceil(Math.max(row0, row1) + radius));
    const left = Math.max(0, Math.floor(Math.min(col0, col1) - radius)), right = Math.min(this.cols - 1, Math.ceil(Math.max(col0, col1) + radius));
    for (let row = top; row <= bottom; row++) {
      for (let col = left; col <= right; col++) {
        const y = row + 0.5 - row0, x = col + 0.5 - col0;
        const along = length > 0 ? Math.min(1, Math.max(0, (y * dr + x * dc) / length)) : 0;
        const away = (y - along * dr) ** 2 + (x - along * dc) ** 2;
        // A brush of one pixel paints the pixel that it points at, wherever within it.
        const hit = away <= radius * radius || (row === Math.floor(row1) && col === Math.floor(col1));
        if (hit) this.levels[row * this.cols + col] = level;
      }
    }
  }
}

const PRESETS = {
  white: ["White", () => () => 1],
  black: ["Black", () => () => 0],
  vertical: ["Vertical stripes", (period) => (row, col) => +(col % period < period / 2)],
  horizontal: ["Horizontal stripes", (period) => (row) => +(row % period < period / 2)],
  checks: ["Checkerboard", (period) => (row, col) => +((row % period < period / 2) !== (col % period < period / 2))],
  waves: ["Sine waves", (period) => (row, col) => 0.5 + 0.5 * Math.cos((2 * Math.PI * col) / period)],
  ramp: ["Ramp", (period, rows, cols) => (row, col) => col / Math.max(1, cols - 1)],
  random: ["Random pixels", () => { const next = randomBits(1); return () => next(); }],
};

/** Random bits that are the same every time (xorshift). */
function randomBits(seed) {
  let state = 0x9e3779b9 ^ seed;
  return () => { state ^= state << 13; state ^= state >>> 17; state ^= state << 5; return (state >>> 16) & 1; };
}

// --- pictures ------------------------------------------------------------------------------------

const VERTEX = `#version 300 es
in vec2 corner; void main() { gl_Position = vec4(corner, 0.0, 1.0); }`;
// `place` is the upper left corner of the image on the canvas and the size of one of its pixels.
const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
uniform highp sampler2D image; uniform sampler2D colours;
uniform vec4 place; uniform vec2 size; uniform vec3 paper; uniform float canvasHeight;
uniform float low, high, gain, gamma; uniform bool grey, coloured, logarithmic, marked;
out vec4 shown;
const vec3 CLIPPED = vec3(0.90, 0.10, 0.12), UNKNOWN = vec3(0.7);
void main() {
  vec2 at = (vec2(gl_FragCoord.x, canvasHeight - gl_FragCoord.y) - place.xy) / place.zw;
  if (any(lessThan(at, vec2(0.0))) || any(greaterThanEqual(at, size))) { shown = vec4(paper, 1.0); return; }
  vec3 value = texelFetch(image, ivec2(at), 0).rgb;
  if (grey) value = value.rrr;
  if (isnan(value.r)) { shown = vec4(UNKNOWN, 1.0); return; }
  vec3 light = value * gain;
  if (coloured) {
    float v = grey ? light.r : dot(light, vec3(1.0 / 3.0));
    float t = logarithmic ? log(max(v, 1e-30) / low) / log(high / low) : (v - low) / (high - low);
    t = pow(clamp(t, 0.0, 1.0), 1.0 / gamma);
    shown = texelFetch(colours, ivec2(int(t * 255.0 + 0.5), 0), 0);
  } else shown = vec4(pow(clamp(light, 0.0, 1.0), vec3(1.0 / gamma)), 1.0);
  if (marked && any(greaterThanEqual(light, vec3(1.0)))) shown = vec4(CLIPPED, 1.0);
}`;

/** A canvas that draws one image of floating point numbers with WebGL2. */
class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("This browser has no WebGL2, which draws the pictures.");
    this.colourName = null;
    this.shape = null;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this.#prepare(); if (this.source) this.upload(...this.source); this.onrestored?.(); });
    this.#prepare();
  }

  #prepare() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "corner");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    this.at = Object.fromEntries(["image", "colours", "place", "size", "paper", "canvasHeight", "low", "high", "gain", "gamma", "grey", "coloured", "logarithmic", "marked"].map((name) => [name, gl.getUniformLocation(program, name)]));
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.textures = [gl.createTexture(), gl.createTexture()];
    this.textures.forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    });
    gl.uniform1i(this.at.image, 0);
    gl.uniform1i(this.at.colours, 1);
    this.shape = this.colourName = null;
  }

  /** Take the numbers of an image, (rows, cols) or (rows, cols, 3). */
  upload(values, rows, cols, channels) {
    const gl = this.gl;
    this.source = [values, rows, cols, channels];
    const numbers = values instanceof Float32Array ? values : new Float32Array(values);
    const [inner, format] = channels === 3 ? [gl.RGB32F, gl.RGB] : [gl.R32F, gl.RED];
    gl.activeTexture(gl.TEXTURE0);
    const shape = `${rows} ${cols} ${channels}`;
    if (shape === this.shape) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, cols, rows, format, gl.FLOAT, numbers);
    else gl.texImage2D(gl.TEXTURE_2D, 0, inner, cols, rows, 0, format, gl.FLOAT, numbers);
    this.shape = shape;
  }

  /** Draw it. `look` is how (gain, gamma, colours, ...), `place` where on the canvas. */
  draw(look, place, paper, height = this.canvas.height, width = this.canvas.width) {
    const gl = this.gl, [, rows, cols, channels] = this.source;
    if (look.colours && look.colours !== this.colourName) {
      gl.activeTexture(gl.TEXTURE1);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, look.colours);
      this.colourName = look.colours;
    }
    gl.viewport(0, 0, width, height);
    gl.uniform4f(this.at.place, place.left, place.top, place.scale, place.scale);
    gl.uniform2f(this.at.size, cols, rows);
    gl.uniform3fv(this.at.paper, paper);
    gl.uniform1f(this.at.canvasHeight, height);
    for (const [name, usual] of [["low", 0], ["high", 1], ["gain", 1], ["gamma", 1]]) gl.uniform1f(this.at[name], look[name] ?? usual);
    gl.uniform1i(this.at.grey, channels !== 3);
    gl.uniform1i(this.at.coloured, !!look.colours);
    gl.uniform1i(this.at.logarithmic, !!look.logarithmic);
    gl.uniform1i(this.at.marked, !!look.marked);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** The image as drawn, one pixel for each of its own: RGBA bytes, top row first. */
  pixels(look) {
    const gl = this.gl, [, rows, cols] = this.source;
    const target = gl.createTexture(), frame = gl.createFramebuffer();
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, target);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, cols, rows);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
    this.draw(look, { left: 0, top: 0, scale: 1 }, [0, 0, 0], rows, cols);
    const upsideDown = new Uint8Array(4 * rows * cols), bytes = new Uint8ClampedArray(4 * rows * cols);
    gl.readPixels(0, 0, cols, rows, gl.RGBA, gl.UNSIGNED_BYTE, upsideDown);
    for (let row = 0; row < rows; row++) bytes.set(upsideDown.subarray(4 * cols * (rows - 1 - row), 4 * cols * (rows - row)), 4 * cols * row);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame);
    gl.deleteTexture(target);
    return new ImageData(bytes, cols, rows);
  }
}

// --- controls ------------------------------------------------------------------------------------

const TOOLS = {
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
const slider = (name, title, low, high, step, value) =>
  `<label class="slider"><span>${title}</span><span class="value" data-of="${name}" aria-hidden="true"></span><input type="range" name="${name}" aria-label="${title}" min="${low}" max="${high}" step="${step}" value="${value}"></label>`;
const TEMPLATE = `
  <header class="bar"><h1></h1><p class="facts"></p><p class="notice" role="alert" hidden></p></header>
  <div class="panes">
    ${pane("projector", "Projector", "Projector. Arrow keys move the pointer, Space paints, Enter puts the brush down.")}
    ${pane("camera", "Camera", "Camera. Arrow keys move the pointer; the row of the camera pixel appears on the projector.")}
  </div>
  <form class="controls" autocomplete="off">
    <fieldset class="tools"><legend>Tool</legend><div class="choice">${Object.entries(TOOLS).map(([name, [title, key, hint]]) => `<label title="${hint} (${key.toUpperCase()})"><input type="radio" name="tool" value="${name}"${name === "brush" ? " checked" : ""}><span>${title}</span></label>`).join("")}</div>
      ${slider("size", "Size", 1, 64, 1, 8)}${slider("intensity", "Intensity", 0, 100, 1, 100)}
      <div class="row"><button type="button" name="undo">Undo</button><button type="button" name="redo">Redo</button></div></fieldset>
    <fieldset><legend>Pattern</legend>
      <div class="row"><label class="grow"><span class="hidden">Stored pattern</span><select name="preset"><option value="">Choose a pattern</option>${Object.entries(PRESETS).map(([name, [title]]) => `<option value="${name}">${title}</option>`).join("")}</select></label></div>
      ${slider("period", "Period", 2, 64, 1, 16)}
      <div class="row"><button type="button" name="clear">Clear</button><button type="button" name="invert">Invert</button><button type="button" name="picture">Picture\u2026</button></div>
      <input type="file" accept="image/*" hidden aria-label="Picture for the projector"></fieldset>
    <fieldset><legend>Display</legend>
      ${slider("exposure", "Exposure", -8, 8, 0.05, 0)}${slider("gamma", "Gamma", 1, 4, 0.05, 2.2)}
      <div class="row"><label class="check"><input type="checkbox" name="false"><span>False colour</span></label><label class="check"><input type="checkbox" name="marked"><span>Mark clipped</span></label></div>
      <div class="row"><button type="button" name="auto">Auto exposure</button><span class="zooms"><button type="button" name="out" aria-label="Zoom out">\u2212</button><button type="button" name="fit">Fit</button><button type="button" name="in" aria-label="Zoom in">+</button></span></div></fieldset>
    <fieldset><legend>Files and keys</legend>
      <div class="row"><button type="button" name="snapshot">Save photograph</button><button type="button" name="save">Save pattern</button></div>
      <details><summary>Keyboard</summary><dl>${KEYS.map(([key, what]) => `<div><dt>${key}</dt><dd>${what}</dd></div>`).join("")}</dl></details></fieldset>
  </form>
  <p class="status" role="status"></p>`;

// A row or column is drawn with this power of its values, which makes faint light visible; as in
// lightmatrix.pictures.transport.
const FAINT = 1 / 0.35;
const RECENT = 512;

export class Viewer {
  constructor(root, source, scene, matrix) {
    Object.assign(this, { root, source, matrix, scene: scene.header, colours: scene.arrays });
    root.classList.add("lightmatrix-viewer");
    root.innerHTML = TEMPLATE;
    const { camera, projector } = this.scene;
    this.channels = camera[2] ?? 1;
    this.sizes = { projector, camera: camera.slice(0, 2) };
    this.pattern = new Pattern(projector);
    this.lit = new Uint8Array(this.pattern.levels.length);
    this.photograph = new Float64Array(matrix.samples);
    this.view = { zoom: 1, x: 0.5, y: 0.5 };
    this.shown = { projector: "", camera: "" };
    this.layers = {};
    this.overlay = { projector: null, camera: null };
    this.pointer = { projector: null, camera: null };
    this.latencies = [];
    this.eventTime = null;
    this.ruler = null;
    this.form = root.querySelector("form");
    this.field = Object.fromEntries([...this.form.elements].filter((field) => field.name && field.type !== "radio").map((field) => [field.name, field]));
    this.panes = {};
    for (const element of root.querySelectorAll(".pane")) this.#addPane(element);
    root.querySelector("h1").textContent = this.scene.title;
    root.querySelector(".facts").textContent = `projector ${projector.join(" \u00d7 ")}, camera ${this.sizes.camera.join(" \u00d7 ")}${this.channels > 1 ? `, ${this.channels} channels` : ""}`;
    this.field.size.max = Math.max(8, Math.ceil(Math.max(...projector) / 2));
    this.field.size.value = Math.max(1, Math.round(Math.max(...projector) / 12));
    this.field.period.max = Math.max(4, Math.ceil(Math.max(...projector) / 2));
    this.field.period.value = Math.max(2, Math.round(Math.max(...projector) / 8));
    this.field.exposure.value = Math.log2(1 / matrix.white);
    this.#listen();
    this.#readAddress();
    const [rows, cols] = projector;
    this.pattern.fill((row, col) => +((row + 0.5 - rows / 2) ** 2 + (col + 0.5 - cols / 2) ** 2 <= (Math.min(rows, cols) / 5) ** 2));
    this.pattern.past = [];
    new ResizeObserver(() => this.redraw()).observe(root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    this.#showValues();
    this.change();
  }

  #addPane(element) {
    const side = element.dataset.side, stage = element.querySelector(".stage");
    const picture = new Picture(element.querySelector("canvas.image"));
    picture.onrestored = () => this.redraw();
    const made = { side, element, stage, picture, marks: element.querySelector("canvas.marks"), select: element.querySelector("select"), place: element.querySelector(".place"), scale: element.querySelector(".scale") };
    this.panes[side] = made;
    const own = side === "projector" ? "Pattern" : "Relit";
    const others = Object.entries(this.scene.layers).filter(([, layer]) => layer.side === side);
    made.select.replaceChildren(new Option(own, ""), ...others.map(([name, layer]) => new Option(layer.title, name)));
    made.select.addEventListener("change", () => this.showLayer(side, made.select.value));
    stage.addEventListener("pointerdown", (event) => this.#press(made, event));
    stage.addEventListener("pointermove", (event) => this.#move(made, event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) stage.addEventListener(kind, () => this.#release());
    stage.addEventListener("pointerleave", () => this.#leave(made));
    stage.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), this.#normal(made, event)); }, { passive: false });
    stage.addEventListener("keydown", (event) => this.#key(made, event));
    stage.addEventListener("blur", () => { if (!stage.matches(":hover")) this.#leave(made); });
  }

  #listen() {
    const buttons = {
      undo: () => this.pattern.undo() && this.change(), redo: () => this.pattern.redo() && this.change(),
      clear: () => this.fill(() => 0), invert: () => this.invert(), picture: () => this.form.querySelector("[type=file]").click(),
      auto: () => this.autoExposure(), out: () => this.zoom(1 / 1.5), in: () => this.zoom(1.5), fit: () => this.fit(),
      snapshot: () => this.#download(this.snapshot(), "photograph"), save: () => this.#download(this.patternImage(), "pattern"),
    };
    for (const [name, action] of Object.entries(buttons)) this.field[name].addEventListener("click", action);
    this.form.addEventListener("submit", (event) => event.preventDefault());
    this.form.addEventListener("input", (event) => this.#input(event.target.name));
    this.form.querySelector("[type=file]").addEventListener("change", (event) => { this.usePicture(event.target.files[0]); event.target.value = ""; });
    this.root.addEventListener("dragover", (event) => { event.preventDefault(); this.root.classList.add("dropping"); });
    this.root.addEventListener("dragleave", (event) => { if (!this.root.contains(event.relatedTarget)) this.root.classList.remove("dropping"); });
    this.root.addEventListener("drop", (event) => { event.preventDefault(); this.root.classList.remove("dropping"); this.usePicture(event.dataTransfer.files[0]); });
    this.root.addEventListener("keydown", (event) => this.#shortcut(event));
  }

  #input(name) {
    if (name === "preset" || name === "period") {
      const preset = PRESETS[this.field.preset.value];
      if (preset && (name === "preset" || preset[1].length)) this.fill(preset[1](+this.field.period.value, this.pattern.rows, this.pattern.cols));
    }
    if (name === "tool") { this.#clearOverlays(); this.say(TOOLS[this.tool][2]); }
    this.#showValues();
    this.redraw();
    this.#writeAddress();
  }

  get tool() { return this.form.elements.tool.value; }
  get gain() { return 2 ** +this.field.exposure.value; }

  #showValues() {
    const texts = {
      size: `${this.field.size.value} px`, intensity: `${this.field.intensity.value} %`, period: `${this.field.period.value} px`,
      exposure: `\u00d7 ${(+this.gain.toPrecision(3)).toString()}`, gamma: (+this.field.gamma.value).toFixed(2).replace(/\.?0+$/, ""),
    };
    for (const [name, text] of Object.entries(texts)) {
      this.form.querySelector(`[data-of=${name}]`).textContent = text;
      this.field[name].setAttribute("aria-valuetext", text);
    }
    this.field.undo.disabled = this.pattern.past.length === 0;
    this.field.redo.disabled = this.pattern.future.length === 0;
  }

  say(text) { this.root.querySelector(".status").textContent = text; }

  /** Tell what the user must know, until it is over (text ""). */
  notice(text) {
    const place = this.root.querySelector(".notice");
    place.textContent = text;
    place.hidden = !text;
  }

  // --- the pattern and the photograph ---

  fill(level) { this.pattern.fill(level); this.change(); }
  invert() { this.pattern.keep(); this.pattern.levels.forEach((level, k, levels) => { levels[k] = 255 - level; }); this.change(); }

  /** Show a picture on the projector: grey, filling it, cut off at the sides that are too long. */
  async usePicture(file) {
    if (!file) return;
    let bitmap;
    try { bitmap = await createImageBitmap(file); } catch { this.notice(`${file.name} is not a picture that this browser can read. PNG and JPEG work.`); return; }
    this.notice("");
    const { rows, cols } = this.pattern, canvas = new OffscreenCanvas(cols, rows), context = canvas.getContext("2d");
    const scale = Math.max(cols / bitmap.width, rows / bitmap.height);
    context.fillRect(0, 0, cols, rows);
    context.imageSmoothingQuality = "high";
    context.drawImage(bitmap, (cols - scale * bitmap.width) / 2, (rows - scale * bitmap.height) / 2, scale * bitmap.width, scale * bitmap.height);
    const { data } = context.getImageData(0, 0, cols, rows);
    this.pattern.keep();
    for (let k = 0; k < rows * cols; k++) this.pattern.levels[k] = Math.round(0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2]);
    this.change();
  }

  /** The pattern changed: relight what changed, and draw both panes with the next frame. */
  change() {
    this.changed = true;
    this.#showValues();
    this.redraw();
  }

  /** Bring the photograph up to date with the pattern: only columns that changed are added. */
  relight() {
    const { levels } = this.pattern, changed = [];
    for (let k = 0; k < levels.length; k++) if (levels[k] !== this.lit[k]) changed.push(k);
    if (changed.length > levels.length / 2) this.photograph = this.matrix.relight(levels);
    else this.matrix.add(this.photograph, changed, (k) => (levels[k] - this.lit[k]) / 255);
    this.lit.set(levels);
    this.changed = false;
  }

  // --- layers, rows and columns ---

  async showLayer(side, name) {
    this.#clearOverlays();
    if (name && !this.layers[name]) {
      this.say("Computing the layer\u2026");
      try { this.layers[name] = unpack(await this.source.layer(name)); } catch (error) { this.say(""); this.notice(error.message); this.panes[side].select.value = this.shown[side]; return; }
      this.say("");
    }
    this.shown[side] = name;
    this.panes[side].select.value = name;
    this.redraw();
    this.#writeAddress();
  }

  /** Show the row of a camera pixel on the projector. */
  showRow(row, col) {
    const cols = this.sizes.camera[1];
    this.overlay.projector = { values: this.matrix.row((row * cols + col) * this.channels, this.channels), title: `Row of camera pixel ${row}, ${col}` };
    this.redraw();
  }

  /** Show the column of a projector pixel in the camera. */
  showColumn(row, col) {
    this.overlay.camera = { values: this.matrix.column(row * this.pattern.cols + col), title: `Column of projector pixel ${row}, ${col}` };
    this.redraw();
  }

  #clearOverlays() { this.overlay = { projector: null, camera: null }; this.redraw(); }

  /** What a pane shows now, and how: values, channels, look and the words for its scale. */
  #content(side) {
    const overlay = this.overlay[side], layer = this.layers[this.shown[side]];
    if (overlay) {
      const high = Math.max(overlay.values.reduce((most, value) => Math.max(most, value), 0), 1e-12);
      const look = { colours: this.colours.faint, low: 0, high, gamma: FAINT };
      return { values: overlay.values, channels: side === "camera" ? this.channels : 1, look, label: overlay.title };
    }
    if (layer) {
      const { header, arrays } = layer, channels = header.white ? arrays.values.length / this.sizes[side][0] / this.sizes[side][1] : 1;
      if (header.white) return { values: arrays.values, channels, look: { gain: 1 / header.white, gamma: +this.field.gamma.value } };
      return { values: arrays.values, channels, look: { colours: arrays.colours, low: header.low, high: header.high, logarithmic: header.logarithmic }, label: header.label };
    }
    if (side === "projector") return { values: this.pattern.levels, channels: 1, look: { gain: 1 / 255 } };
    const look = { gain: this.gain, gamma: +this.field.gamma.value, marked: this.field.marked.checked };
    if (this.field.false.checked) return { values: this.photograph, channels: this.channels, look: { ...look, colours: this.colours.false }, label: "of full scale", top: 1 / this.gain };
    return { values: this.photograph, channels: this.channels, look };
  }

  // --- drawing ---

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.#frame());
  }

  #frame() {
    this.waiting = false;
    if (this.changed) this.relight();
    const paper = getComputedStyle(this.root).getPropertyValue("--stage").trim();
    const colour = [1, 3, 5].map((start) => parseInt(paper.slice(start, start + 2), 16) / 255);
    for (const made of Object.values(this.panes)) this.#draw(made, colour);
    if (this.eventTime !== null) {
      this.latencies.push(performance.now() - this.eventTime);
      if (this.latencies.length > RECENT) this.latencies.shift();
      this.eventTime = null;
    }
  }

  #draw(made, paper) {
    const { picture, stage, side, marks } = made, content = this.#content(side), [rows, cols] = this.sizes[side];
    const ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(stage.clientWidth * ratio)), height = Math.max(1, Math.round(stage.clientHeight * ratio));
    for (const canvas of [picture.canvas, marks]) if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    picture.upload(content.values, rows, cols, content.channels);
    made.look = content.look;
    made.at = this.#placeOf(side, width, height);
    picture.draw(content.look, made.at, paper);
    this.#drawMarks(made, ratio);
    this.#drawScale(made, content);
  }

  /** Where an image lies on a canvas: both panes show the same share of their images. */
  #placeOf(side, width, height) {
    const [rows, cols] = this.sizes[side], { zoom, x, y } = this.view;
    const scale = Math.min(width / cols, height / rows) * zoom;
    return { scale, left: width / 2 - x * cols * scale, top: height / 2 - y * rows * scale };
  }

  #drawMarks({ marks, at, side }, ratio) {
    const context = marks.getContext("2d");
    context.clearRect(0, 0, marks.width, marks.height);
    const twice = (draw) => {
      // Dark below bright, so that it is seen on any picture.
      for (const [style, width] of [["rgba(0,0,0,.75)", 3], ["#fff", 1.25]]) {
        Object.assign(context, { strokeStyle: style, lineWidth: width * ratio });
        context.beginPath(); draw(); context.stroke();
      }
    };
    const pointer = this.pointer[side];
    if (pointer) {
      const [row, col] = pointer, x = at.left + col * at.scale, y = at.top + row * at.scale;
      if (side === "projector" && (this.tool === "brush" || this.tool === "eraser")) {
        twice(() => context.arc(x, y, Math.max(at.scale * this.field.size.value / 2, 2 * ratio), 0, 2 * Math.PI));
      } else {
        const reach = 9 * ratio, gap = 3 * ratio;
        twice(() => { for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { context.moveTo(x + gap * dx, y + gap * dy); context.lineTo(x + reach * dx, y + reach * dy); } });
      }
    }
    if (this.ruler?.side === side) {
      const [[row0, col0], [row1, col1]] = [this.ruler.from, this.ruler.to];
      twice(() => { context.moveTo(at.left + col0 * at.scale, at.top + row0 * at.scale); context.lineTo(at.left + col1 * at.scale, at.top + row1 * at.scale); });
    }
  }

  #drawScale({ scale, side, place }, { look, label, top }) {
    const canvas = scale.querySelector("canvas");
    scale.hidden = !look.colours;
    if (!look.colours) return;
    const context = canvas.getContext("2d"), bar = context.createImageData(256, 1);
    for (let k = 0; k < 256; k++) {
      // The bar is even in the values, so the power of the picture bends its colours.
      const colour = Math.round(255 * (k / 255) ** (1 / (look.logarithmic ? 1 : look.gamma ?? 1)));
      bar.data.set([...look.colours.subarray(3 * colour, 3 * colour + 3), 255], 4 * k);
    }
    context.putImageData(bar, 0, 0);
    scale.querySelector(".low").textContent = number(look.low ?? 0);
    scale.querySelector(".high").textContent = number(top ?? look.high ?? 1);
    scale.querySelector(".unit").textContent = label ?? "";
  }

  // --- pointing ---

  /** The place on the image that an event points at: row and column with fractions. */
  #spot(made, event) {
    const box = made.stage.getBoundingClientRect(), ratio = made.picture.canvas.width / box.width;
    return [((event.clientY - box.top) * ratio - made.at.top) / made.at.scale, ((event.clientX - box.left) * ratio - made.at.left) / made.at.scale];
  }

  #normal(made, event) {
    const [row, col] = this.#spot(made, event), [rows, cols] = this.sizes[made.side];
    return { x: col / cols, y: row / rows };
  }

  #inside(side, [row, col]) { const [rows, cols] = this.sizes[side]; return row >= 0 && col >= 0 && row < rows && col < cols; }

  #press(made, event) {
    if (!made.at || (event.button !== 0 && event.button !== 1)) return;
    made.stage.setPointerCapture(event.pointerId);
    const spot = this.#spot(made, event), moving = this.tool === "move" || event.button === 1;
    this.drag = { made, from: spot, last: spot, moving, view: { ...this.view }, start: [event.clientX, event.clientY] };
    if (!moving) this.#use(made, spot, true, event.timeStamp);
    event.preventDefault();
    made.stage.focus({ preventScroll: true, focusVisible: false });
  }

  #move(made, event) {
    if (!made.at) return;
    const drag = this.drag?.made === made ? this.drag : null;
    // Browsers join the movements of one frame; a fast stroke needs all of them.
    const events = drag && event.getCoalescedEvents ? event.getCoalescedEvents() : [];
    for (const one of events.length ? events : [event]) {
      const spot = this.#spot(made, one);
      if (drag?.moving) {
        const ratio = made.picture.canvas.width / made.stage.clientWidth, [rows, cols] = this.sizes[made.side];
        this.#setView({ zoom: this.view.zoom, x: drag.view.x - (one.clientX - drag.start[0]) * ratio / made.at.scale / cols, y: drag.view.y - (one.clientY - drag.start[1]) * ratio / made.at.scale / rows });
      } else if (drag) this.#use(made, spot, false, one.timeStamp);
      this.#point(made, spot);
    }
  }

  #release() {
    if (this.drag && !this.drag.moving) this.#showValues();
    this.drag = null;
  }

  /** Use the tool at a place; `first` when it is put down. */
  #use({ side }, spot, first, time) {
    const tool = this.tool;
    if (tool === "ruler") {
      this.ruler = { side, from: first ? spot : this.ruler.from, to: spot };
      const [row, col] = [0, 1].map((k) => spot[k] - this.ruler.from[k]);
      this.say(`${Math.hypot(row, col).toFixed(1)} px (${Math.abs(row).toFixed(1)} down, ${Math.abs(col).toFixed(1)} across)`);
    } else if (side === "projector" && tool === "column") {
      if (this.#inside(side, spot)) this.showColumn(...spot.map(Math.floor));
    } else if (side === "projector" && (tool === "brush" || tool === "eraser")) {
      if (first) {
        this.pattern.keep();
        this.overlay = { projector: null, camera: null };
        if (this.shown.projector) this.showLayer("projector", "");
        if (this.shown.camera) this.showLayer("camera", "");
      }
      const level = tool === "eraser" ? 0 : Math.round(2.55 * this.field.intensity.value);
      this.pattern.stroke(first ? spot : this.drag?.last ?? this.last ?? spot, spot, +this.field.size.value, level);
      this.eventTime ??= time;
      this.change();
    }
    if (this.drag) this.drag.last = spot;
    this.last = spot;
    this.redraw();
  }

  /** The pointer, of the mouse or of the keyboard, is at a place: mark it and tell its value. */
  #point(made, spot) {
    const { side, place } = made, inside = this.#inside(side, spot), [row, col] = spot.map(Math.floor);
    this.pointer[side] = inside || side === "projector" ? spot : null;
    if (!inside) { place.textContent = "\u00a0"; if (side === "camera") this.overlay.projector = null; this.redraw(); return; }
    if (side === "camera" && !this.drag && this.tool !== "ruler" && this.tool !== "move" && !this.overlay.camera) this.showRow(row, col);
    const { values, channels } = this.#content(side), start = (row * this.sizes[side][1] + col) * channels;
    const shown = Array.from(values.slice(start, start + channels), (value) => side === "projector" && values === this.pattern.levels ? number(value / 255) : number(value));
    place.textContent = `row ${row}, column ${col}: ${shown.join(" ")}`;
    this.redraw();
  }

  #leave(made) {
    if (this.drag) return;
    this.pointer[made.side] = null;
    made.place.textContent = "\u00a0";
    if (made.side === "camera") this.overlay.projector = null;
    this.redraw();
  }

  // --- keyboard ---

  #key(made, event) {
    const steps = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
    const [rows, cols] = this.sizes[made.side];
    const middle = [Math.floor(rows / 2) + 0.5, Math.floor(cols / 2) + 0.5], at = this.pointer[made.side] ?? middle;
    if (steps && !event.ctrlKey && !event.metaKey && !event.altKey) {
      const far = event.shiftKey ? 8 : 1, limits = [rows, cols];
      const spot = [0, 1].map((k) => Math.min(limits[k] - 0.5, Math.max(0.5, Math.floor(at[k]) + 0.5 + far * steps[k])));
      this.last = at;
      if (this.down) this.#use(made, spot, false, event.timeStamp);
      this.#point(made, spot);
      this.say(made.place.textContent);
    } else if (event.key === " ") {
      this.#use(made, at, true, event.timeStamp);
      this.#point(made, at);
    } else if (event.key === "Enter") {
      this.down = !this.down;
      if (this.down) this.#use(made, at, true, event.timeStamp);
      this.say(this.down ? "The tool is down: arrows use it." : "The tool is lifted.");
    } else return;
    event.preventDefault();
  }

  #shortcut(event) {
    const typing = event.target.matches?.("select, input:not([type=radio]):not([type=checkbox]):not([type=range])");
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey) {
      if (key === "z") (event.shiftKey ? this.field.redo : this.field.undo).click();
      else if (key === "y") this.field.redo.click();
      else return;
      event.preventDefault();
      return;
    }
    if (typing || event.altKey) return;
    const tool = Object.entries(TOOLS).find(([, [, letter]]) => letter === key)?.[0];
    if (tool) { this.form.elements.tool.value = tool; this.down = false; this.#input("tool"); }
    else if (key === "[" || key === "]") { this.field.size.value = +this.field.size.value + (key === "]" ? 1 : -1); this.#input("size"); this.say(`Brush of ${this.field.size.value} px`); }
    else if (key === "+" || key === "=") this.zoom(1.5);
    else if (key === "-") this.zoom(1 / 1.5);
    else if (key === "0") this.fit();
    else if (key === "i") this.invert();
    else if (key === "escape") { this.down = false; this.ruler = null; this.#clearOverlays(); }
    else return;
    event.preventDefault();
  }

  // --- view, address and files ---

  zoom(factor, at = { x: this.view.x, y: this.view.y }) {
    const zoom = Math.min(64, Math.max(1, this.view.zoom * factor)), share = this.view.zoom / zoom;
    this.#setView({ zoom, x: at.x + (this.view.x - at.x) * share, y: at.y + (this.view.y - at.y) * share });
  }

  fit() { this.#setView({ zoom: 1, x: 0.5, y: 0.5 }); }

  #setView({ zoom, x, y }) {
    const edge = 0.5 / zoom, within = (value) => Math.min(1 - edge, Math.max(edge, value));
    this.view = { zoom, x: within(x), y: within(y) };
    this.redraw();
    this.#writeAddress();
  }

  autoExposure() {
    const sorted = Float64Array.from(this.photograph).sort();
    const white = sorted[Math.floor(0.995 * (sorted.length - 1))];
    if (white > 0) this.field.exposure.value = Math.log2(1 / white);
    this.#input("exposure");
  }

  /** The view as text for the address, so that it can be sent. */
  #writeAddress() {
    if (!this.source.keepsAddress) return;
    clearTimeout(this.addressTimer);
    this.addressTimer = setTimeout(() => {
      const { zoom, x, y } = this.view;
      const words = new URLSearchParams({ zoom: number(zoom), x: number(x), y: number(y), exposure: this.field.exposure.value, gamma: this.field.gamma.value });
      for (const name of ["false", "marked"]) if (this.field[name].checked) words.set(name, "1");
      for (const side of ["camera", "projector"]) if (this.shown[side]) words.set(side, this.shown[side]);
      try { history.replaceState(null, "", `#${words}`); } catch { /* a sandboxed page keeps its address */ }
    }, 200);
  }

  #readAddress() {
    if (!this.source.keepsAddress) return;
    const words = new URLSearchParams(location.hash.slice(1)), numbers = {};
    for (const name of ["zoom", "x", "y", "exposure", "gamma"]) if (words.has(name) && Number.isFinite(+words.get(name))) numbers[name] = +words.get(name);
    for (const name of ["exposure", "gamma"]) if (name in numbers) this.field[name].value = numbers[name];
    for (const name of ["false", "marked"]) this.field[name].checked = words.get(name) === "1";
    this.#setView({ zoom: Math.min(64, Math.max(1, numbers.zoom ?? 1)), x: numbers.x ?? 0.5, y: numbers.y ?? 0.5 });
    for (const side of ["camera", "projector"]) if (this.scene.layers[words.get(side)]?.side === side) this.showLayer(side, words.get(side));
  }

  /** What the camera pane shows, one pixel for each of the camera's. */
  snapshot() { this.#frame(); return this.panes.camera.picture.pixels(this.panes.camera.look); }

  /** The pattern, one pixel for each of the projector's. */
  patternImage() {
    const { rows, cols, levels } = this.pattern, image = new ImageData(cols, rows);
    levels.forEach((level, k) => image.data.set([level, level, level, 255], 4 * k));
    return image;
  }

  async #download(image, name) {
    const canvas = new OffscreenCanvas(image.width, image.height);
    canvas.getContext("2d").putImageData(image, 0, 0);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await canvas.convertToBlob({ type: "image/png" }));
    link.download = `${name}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }
}

/** A number of three digits, as people write it. */
function number(value) {
  if (!Number.isFinite(value)) return "unknown";
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(1) : String(+value.toPrecision(3));
}

// --- sources -------------------------------------------------------------------------------------

/** Scene, matrix and layers from the server that sent the page. */
export class ServerSource {
  keepsAddress = true;
  async #get(name) {
    const answer = await fetch(name);
    if (!answer.ok) throw new Error(await answer.text());
    return answer.arrayBuffer();
  }
  scene() { return this.#get("scene.bin"); }
  matrix() { return this.#get("matrix.bin"); }
  layer(name) { return this.#get(`layer/${name}.bin`); }

  /** Tell the viewer what happens to the store and to the server. */
  watch(viewer) {
    const socket = new WebSocket(new URL("socket", location.href).href.replace(/^http/, "ws").replace(/#.*/, ""));
    socket.onmessage = (event) => viewer.notice(JSON.parse(event.data).notice);
    socket.onclose = () => viewer.notice("The server has ended. What is on this page still works; start `lightmatrix view` again for the rest.");
  }
}

/** Everything is in the page: elements <script type="text/plain"> with base64. */
export class PageSource {
  keepsAddress = true;
  #read(name) {
    const element = document.getElementById(`data-${name}`);
    return Uint8Array.from(atob(element.textContent.trim()), (letter) => letter.charCodeAt(0)).buffer;
  }
  async scene() { return this.#read("scene"); }
  async matrix() { return this.#read("matrix"); }
  async layer(name) { return this.#read(`layer-${name}`); }
  watch() {}
}

/** Show the viewer in an element. */
export async function show(root, source) {
  try {
    const [scene, matrix] = (await Promise.all([source.scene(), source.matrix()])).map(unpack);
    const viewer = new Viewer(root, source, scene, new Matrix(matrix, scene.header));
    source.watch(viewer);
    return viewer;
  } catch (error) {
    root.textContent = error.message;
    root.setAttribute("role", "alert");
    throw error;
  }
}

const place = globalThis.document?.querySelector("main[data-viewer]");
if (place) globalThis.lightmatrixViewer = await show(place, place.dataset.viewer === "server" ? new ServerSource() : new PageSource());
