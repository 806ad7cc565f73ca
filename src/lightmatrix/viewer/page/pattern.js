// What the projector shows, and the patterns that are stored.

// Patterns that can be undone. Each keeps one byte a pixel, so large projectors keep fewer.
const UNDO_BYTES = 64 << 20, FEWEST_UNDOS = 5, MOST_UNDOS = 200;

/** What the projector shows: 8-bit levels, with undo and redo. */
export class Pattern {
  constructor([rows, cols]) {
    Object.assign(this, { rows, cols, levels: new Uint8Array(rows * cols), past: [], future: [] });
    this.most = Math.max(FEWEST_UNDOS, Math.min(MOST_UNDOS, Math.floor(UNDO_BYTES / (rows * cols))));
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

  /** Take other levels, one for each pixel. */
  set(levels) {
    this.keep();
    this.levels.set(levels);
  }

  /** Give all pixels the level of a function of (row, column), 0 to 1. */
  fill(level) {
    this.keep();
    for (let row = 0, k = 0; row < this.rows; row++) {
      for (let col = 0; col < this.cols; col++, k++) this.levels[k] = Math.round(255 * level(row, col));
    }
  }

  invert() {
    this.keep();
    this.levels.forEach((level, k, levels) => { levels[k] = 255 - level; });
  }

  /** The soft spotlight with which the viewer begins. */
  begin() {
    const { rows, cols } = this, radius = Math.min(rows, cols) / 4;
    this.fill((row, col) => 0.05 + 0.95 * Math.exp(-(((row + 0.5 - rows / 2) ** 2 + (col + 0.5 - cols / 2) ** 2) / radius ** 2)));
    this.past = [];
  }

  /** Paint every pixel whose centre lies within a brush that moved from one place to another. */
  stroke([row0, col0], [row1, col1], diameter, level) {
    const radius = Math.max(diameter / 2, 0.5);
    const dr = row1 - row0, dc = col1 - col0, length = dr * dr + dc * dc;
    const top = Math.max(0, Math.floor(Math.min(row0, row1) - radius));
    const bottom = Math.min(this.rows - 1, Math.ceil(Math.max(row0, row1) + radius));
    const left = Math.max(0, Math.floor(Math.min(col0, col1) - radius));
    const right = Math.min(this.cols - 1, Math.ceil(Math.max(col0, col1) + radius));
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

/** Stored patterns: a title, and what makes the level at (row, column) from period and size. */
export const PRESETS = {
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
