// A pane: one side's image, the marks above it, its colour scale, and where things lie on it.

import { number } from "./packed.js";
import { Picture } from "./picture.js";

// A mark is drawn dark below bright, so that it is seen on any picture: style and width in pixels.
const STROKES = [["rgba(0,0,0,.75)", 3], ["#fff", 1.25]];

export class Pane {
  constructor(element, [rows, cols]) {
    this.side = element.dataset.side;
    this.size = [rows, cols];
    this.stage = element.querySelector(".stage");
    this.picture = new Picture(element.querySelector("canvas.image"));
    this.marks = element.querySelector("canvas.marks");
    this.select = element.querySelector("select");
    this.place = element.querySelector(".place");
    this.scale = element.querySelector(".scale");
    this.at = null;
  }

  get ratio() { return window.devicePixelRatio || 1; }

  /** Draw what it shows. `marked` has the pointer and the ruler, if they are on this side. */
  draw(content, view, paper, marked) {
    const { picture, stage, marks } = this, [rows, cols] = this.size;
    const [width, height] = [stage.clientWidth, stage.clientHeight].map((size) => Math.max(1, Math.round(size * this.ratio)));
    for (const canvas of [picture.canvas, marks]) {
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    }
    picture.upload(content.values, rows, cols, content.channels);
    this.look = content.look;
    this.at = this.#placeOf(view, width, height);
    picture.draw(content.look, this.at, paper);
    this.#drawMarks(marked);
    this.#drawScale(content);
  }

  /** Where the image lies on the canvas: both panes show the same share of their images. */
  #placeOf({ zoom, x, y }, width, height) {
    const [rows, cols] = this.size, scale = Math.min(width / cols, height / rows) * zoom;
    return { scale, left: width / 2 - x * cols * scale, top: height / 2 - y * rows * scale };
  }

  /** The place on the image that an event points at: row and column with fractions. */
  spot(event) {
    const box = this.stage.getBoundingClientRect(), ratio = this.picture.canvas.width / box.width;
    const { left, top, scale } = this.at;
    return [((event.clientY - box.top) * ratio - top) / scale, ((event.clientX - box.left) * ratio - left) / scale];
  }

  /** The same as shares of the image's height and width. */
  share(event) {
    const [row, col] = this.spot(event), [rows, cols] = this.size;
    return { x: col / cols, y: row / rows };
  }

  inside([row, col]) { return row >= 0 && col >= 0 && row < this.size[0] && col < this.size[1]; }

  #drawMarks({ pointer, brush, ruler }) {
    const context = this.marks.getContext("2d"), { ratio } = this, { left, top, scale } = this.at;
    const x = (col) => left + col * scale, y = (row) => top + row * scale;
    context.clearRect(0, 0, this.marks.width, this.marks.height);
    const twice = (draw) => {
      for (const [strokeStyle, width] of STROKES) {
        Object.assign(context, { strokeStyle, lineWidth: width * ratio });
        context.beginPath();
        draw();
        context.stroke();
      }
    };
    if (pointer && brush) {
      twice(() => context.arc(x(pointer[1]), y(pointer[0]), Math.max(scale * brush / 2, 2 * ratio), 0, 2 * Math.PI));
    } else if (pointer) {
      const reach = 9 * ratio, gap = 3 * ratio;
      twice(() => {
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          context.moveTo(x(pointer[1]) + gap * dx, y(pointer[0]) + gap * dy);
          context.lineTo(x(pointer[1]) + reach * dx, y(pointer[0]) + reach * dy);
        }
      });
    }
    if (ruler) {
      twice(() => {
        context.moveTo(x(ruler.from[1]), y(ruler.from[0]));
        context.lineTo(x(ruler.to[1]), y(ruler.to[0]));
      });
      // The number stays beside its line; left of it where it would leave the picture.
      const far = x(ruler.to[1]) > 0.8 * this.marks.width, side = (far ? -8 : 8) * ratio;
      Object.assign(context, { font: `600 ${13 * ratio}px system-ui, sans-serif`, textAlign: far ? "right" : "left" });
      Object.assign(context, { strokeStyle: "#000", lineWidth: 3 * ratio, fillStyle: "#fff", lineJoin: "round" });
      context.strokeText(ruler.length, x(ruler.to[1]) + side, y(ruler.to[0]));
      context.fillText(ruler.length, x(ruler.to[1]) + side, y(ruler.to[0]));
    }
  }

  #drawScale({ look, label, top }) {
    const { scale } = this;
    scale.hidden = !look.colours;
    if (!look.colours) return;
    const context = scale.querySelector("canvas").getContext("2d"), bar = context.createImageData(256, 1);
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
}
