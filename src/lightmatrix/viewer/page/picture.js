// A picture of floating point numbers, drawn with WebGL2 with exposure, gamma and colours.

const VERTEX = `#version 300 es
in vec2 corner; void main() { gl_Position = vec4(corner, 0.0, 1.0); }`;
// `place` is the upper left corner of the image on the canvas and the size of one of its pixels.
const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
uniform highp sampler2D image; uniform sampler2D colours, behind;
uniform vec4 place; uniform vec2 size; uniform vec3 paper; uniform float canvasHeight;
uniform float low, high, gain, gamma; uniform bool grey, coloured, logarithmic, marked, backed;
out vec4 shown;
const vec3 CLIPPED = vec3(0.90, 0.10, 0.12), UNKNOWN = vec3(0.7), DIM = vec3(0.26, 0.34, 0.48);
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
  // Where the pattern is dark, what lies behind it shows, dim and blue, so that it is not taken for light.
  if (backed) shown.rgb = mix(DIM * texelFetch(behind, ivec2(at), 0).r, shown.rgb, min(4.0 * shown.r, 1.0));
  if (marked && any(greaterThanEqual(light, vec3(1.0)))) shown = vec4(CLIPPED, 1.0);
}`;

/** A canvas that draws one image of floating point numbers with WebGL2. */
export class Picture {
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
    this.at = Object.fromEntries(["image", "colours", "place", "size", "paper", "canvasHeight", "low", "high", "gain", "gamma", "grey", "coloured", "logarithmic", "marked", "behind", "backed"].map((name) => [name, gl.getUniformLocation(program, name)]));
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 3, -1, -1, 3]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    this.textures = [gl.createTexture(), gl.createTexture(), gl.createTexture()];
    this.textures.forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    });
    gl.uniform1i(this.at.image, 0);
    gl.uniform1i(this.at.colours, 1);
    gl.uniform1i(this.at.behind, 2);
    this.shape = this.colourName = this.behind = null;
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
    if (look.behind && look.behind !== this.behind) {
      gl.activeTexture(gl.TEXTURE2);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, cols, rows, 0, gl.RED, gl.UNSIGNED_BYTE, look.behind);
      this.behind = look.behind;
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
    gl.uniform1i(this.at.backed, !!look.behind);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** The image as drawn, one pixel for each of its own: RGBA bytes, top row first. */
  pixels(look) {
    const gl = this.gl, [, rows, cols] = this.source;
    const target = gl.createTexture(), frame = gl.createFramebuffer();
    gl.activeTexture(gl.TEXTURE3);
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

