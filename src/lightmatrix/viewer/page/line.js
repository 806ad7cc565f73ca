// Messages to Python and back; session.py is the other end.

import { unpack } from "./packed.js";

/** The kinds of messages, as in messages.py. */
export const KIND = { paint: 1, row: 2, column: 3, compensate: 4 };

/** Numbered questions over a channel, which only needs to carry bytes both ways. */
export class Line {
  #asked = new Map();
  #number = 0;
  /** Called with (header, arrays) of what belongs to no question: parts of the photograph. */
  onpart = () => {};

  /** `send` takes bytes to Python; who receives bytes from there calls receive(). */
  constructor(send) { this.send = send; }

  /** Send a message of numbers below 2**32 and, behind them, bytes. Returns its number. */
  post(kind, numbers, bytes = new Uint8Array()) {
    const message = new Uint8Array(4 * (numbers.length + 2) + bytes.length), view = new DataView(message.buffer);
    const number = ++this.#number;
    [kind, number, ...numbers].forEach((value, k) => view.setUint32(4 * k, value, true));
    message.set(bytes, message.length - bytes.length);
    this.send(message);
    return number;
  }

  /** Send a message, and wait for its answer. */
  ask(kind, numbers, bytes) {
    return new Promise((done, failed) => this.#asked.set(this.post(kind, numbers, bytes), { done, failed }));
  }

  receive(buffer) {
    const { header, arrays } = unpack(buffer), asked = this.#asked.get(header.answers);
    this.#asked.delete(header.answers);
    if (!asked) this.onpart(header, arrays);
    else if (header.kind === "error") asked.failed(new Error(header.message));
    else asked.done({ header, arrays });
  }
}
