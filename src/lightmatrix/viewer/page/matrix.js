// T in the page: relit stroke by stroke. Pixels are numbered in the order (row, column), camera
// samples in the order (row, column, channel).
//
// RemoteMatrix (remote.js) is the same for matrices that stay in Python. Both have the photograph
// under the levels `lit`, relight() for other levels, and row() and column(), which hand what they
// found to a function.

import { halves } from "./packed.js";

/** T = S + B m in the page: S column by column, B cell by cell. */
export class Matrix {
  busy = false;

  constructor({ header, arrays }, scene) {
    this.samples = scene.camera.reduce((product, size) => product * size);
    this.pixels = scene.projector[0] * scene.projector[1];
    this.cols = scene.projector[1];
    this.cameraCols = scene.camera[1];
    this.channels = scene.camera[2] ?? 1;
    Object.assign(this, { ends: arrays.ends, rows: arrays.rows, values: arrays.values, white: header.white });
    this.table = halves(header.value_scale);
    const cells = scene.grid[0] * scene.grid[1];
    const table = halves(header.background_scale);
    // Plain loops: a function called for each of fifty million values takes seconds.
    const bits = arrays.background, background = this.background = new Float32Array(bits.length);
    let lit = false;
    for (let k = 0; k < bits.length; k++) lit = (background[k] = table[bits[k]]) !== 0 || lit;
    this.litCells = lit ? cells : 0;
    this.cellOf = gridCells(scene.projector, scene.grid);
    this.cellSize = new Float64Array(cells);
    for (const cell of this.cellOf) this.cellSize[cell] += 1;
    this.photograph = new Float64Array(this.samples);
    this.lit = new Uint8Array(this.pixels);
  }

  /**
   * Bring the photograph up to date with the levels of a pattern: only columns that changed are added.
   * Returns the time of the movement that it shows now.
   */
  relight(levels, time = null) {
    const { lit } = this, changed = [];
    for (let k = 0; k < levels.length; k++) if (levels[k] !== lit[k]) changed.push(k);
    if (changed.length > levels.length / 2) {
      // From nothing, so that differences of rounding do not add up.
      this.photograph = new Float64Array(this.samples);
      this.#add(this.photograph, levels.keys(), (pixel) => levels[pixel] / 255);
    } else this.#add(this.photograph, changed, (k) => (levels[k] - lit[k]) / 255);
    lit.set(levels);
    return time;
  }

  /** A column of T: what the camera sees of one projector pixel. */
  column(row, col, show) {
    const image = new Float64Array(this.samples);
    this.#add(image, [row * this.cols + col], () => 1);
    show(image);
  }

  /** The row of one camera pixel, its channels added: how much each projector pixel lights it. */
  row(row, col, show) {
    const { ends, rows, values, table } = this;
    const image = new Float64Array(this.pixels), first = (row * this.cameraCols + col) * this.channels;
    for (let sample = first; sample < first + this.channels; sample++) {
      for (let pixel = 0; pixel < this.pixels; pixel++) {
        // The entries of a column are sorted by row.
        let low = ends[pixel], high = ends[pixel + 1];
        while (low < high) {
          const middle = (low + high) >> 1;
          if (rows[middle] < sample) low = middle + 1;
          else high = middle;
        }
        if (low < ends[pixel + 1] && rows[low] === sample) image[pixel] += table[values[low]];
        const cell = this.cellOf[pixel];
        if (this.litCells) image[pixel] += this.background[cell * this.samples + sample] / this.cellSize[cell];
      }
    }
    show(image);
  }

  /** Add to an image the light of some projector pixels; change() says how much brighter each gets. */
  #add(image, pixels, change) {
    const { ends, rows, values, table, cellOf } = this;
    const means = new Float64Array(this.cellSize.length);
    for (const pixel of pixels) {
      const amount = change(pixel);
      if (amount === 0) continue;
      for (let k = ends[pixel], end = ends[pixel + 1]; k < end; k++) image[rows[k]] += amount * table[values[k]];
      means[cellOf[pixel]] += amount / this.cellSize[cellOf[pixel]];
    }
    for (let cell = 0; cell < this.litCells; cell++) {
      if (means[cell] === 0) continue;
      const start = cell * this.samples;
      for (let i = 0; i < this.samples; i++) image[i] += means[cell] * this.background[start + i];
    }
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
