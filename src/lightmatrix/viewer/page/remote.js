// T that is too large for the page: Python relights it, and sends the parts that changed.

import { KIND } from "./line.js";
import { halves } from "./packed.js";

const HALF = halves(1);
// Milliseconds for which a frame waits for the answer to a stroke. Python takes 5 to 10 of them.
const PATIENCE = 30;

/** T in Python, with the same methods as Matrix; what they find comes later. */
export class RemoteMatrix {
  remote = true;
  /** Called with the time of the first movement that the photograph shows now, or null. */
  onrelit = () => {};
  /** Called with a message if Python could not answer. */
  onerror = () => {};
  /** The message that is not answered yet, its movement, and whether parts are still to come. */
  #sent = null;
  #time = null;
  #finishing = false;
  #question = null;

  constructor(scene, line) {
    this.line = line;
    this.white = scene.white;
    this.camera = scene.camera;
    this.channels = scene.camera[2] ?? 1;
    this.projector = scene.projector;
    this.photograph = new Float32Array(scene.camera.reduce((product, size) => product * size));
    this.lit = new Uint8Array(scene.projector[0] * scene.projector[1]);
    line.onpart = (header, arrays) => this.#receive(header, arrays);
  }

  /** Whether the photograph is not that of the last pattern yet. */
  get busy() { return this.#sent !== null || this.#finishing || this.#question !== null; }

  /** Whether the answer to a stroke is about to come. */
  get expects() { return this.#sent !== null && performance.now() - this.#sent.at < PATIENCE; }

  /** Ask for the photograph under other levels. A question waits until the last one is answered. */
  relight(levels, time) {
    this.levels = levels;
    this.#time ??= time;
    if (this.#sent === null) this.#paint();
    return null;
  }

  #paint() {
    const { levels, lit } = this, [rows, cols] = this.projector;
    let top = rows, left = cols, bottom = -1, right = -1;
    for (let row = 0, k = 0; row < rows; row++) {
      for (let col = 0; col < cols; col++, k++) {
        if (levels[k] === lit[k]) continue;
        if (row < top) top = row;
        if (col < left) left = col;
        if (col > right) right = col;
        bottom = row;
      }
    }
    const time = this.#time;
    this.#time = null;
    if (bottom < 0) {
      if (time !== null) this.onrelit(time);
      return;
    }
    const height = bottom - top + 1, width = right - left + 1, bytes = new Uint8Array(height * width);
    for (let row = 0; row < height; row++) {
      const start = (top + row) * cols + left, line = levels.subarray(start, start + width);
      bytes.set(line, row * width);
      lit.set(line, start);
    }
    this.#sent = { number: this.line.post(KIND.paint, [top, left, height, width], bytes), time, at: performance.now() };
    this.#finishing = true;
  }

  /** A part of the photograph has come. */
  #receive(header, arrays) {
    if (header.kind === "error") {
      this.#finishing = false;
      this.onerror(header.message);
    } else if (header.kind === "samples") {
      arrays.samples.forEach((sample, k) => { this.photograph[sample] = header.scale * HALF[arrays.values[k]]; });
      this.#finishing = header.more;
    } else placeTiles(this.photograph, this.camera[1], this.channels, header, arrays.values);
    if (header.kind === "tiles") this.#finishing = header.more;
    let time = null;
    if (this.#sent?.number === header.answers) {
      ({ time } = this.#sent);
      this.#sent = null;
      if (this.levels) this.#paint();
    }
    this.onrelit(time);
  }

  /** Ask for a row or column, and show it unless another one was asked for meanwhile. */
  async #ask(kind, numbers, show) {
    const waiting = this.#question !== null;
    this.#question = { kind, numbers, show };
    // The last question of several is asked when the first one is answered.
    while (!waiting && this.#question) {
      const question = this.#question;
      try {
        const answer = await this.line.ask(question.kind, question.numbers);
        if (this.#question === question) question.show(answer);
      } catch (error) { this.onerror(error.message); }
      if (this.#question === question) this.#question = null;
    }
  }

  row(row, col, show) {
    this.#ask(KIND.row, [row, col], ({ header, arrays }) => {
      const image = new Float32Array(this.lit.length);
      placeTiles(image, this.projector[1], 1, header, arrays.values);
      show(image);
    });
  }

  column(row, col, show) {
    this.#ask(KIND.column, [row, col], ({ header, arrays }) => {
      const image = new Float32Array(this.photograph.length);
      placeTiles(image, this.camera[1], this.channels, header, arrays.values);
      show(image);
    });
  }

  /** Nobody waits for a row or column any more. */
  forget() { if (this.#question) this.#question.show = () => {}; }
}

/** Put rectangles of values into an image of so many columns and channels. */
function placeTiles(image, cols, channels, { tiles, scale }, values) {
  let from = 0;
  for (const [top, left, height, width] of tiles) {
    for (let row = top; row < top + height; row++) {
      const start = (row * cols + left) * channels, end = start + width * channels;
      for (let k = start; k < end; k++) image[k] = scale * HALF[values[from++]];
    }
  }
}
