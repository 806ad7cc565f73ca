// Where the viewer gets the scene, T and its layers from.

import { Line } from "./line.js";
import { unpack } from "./packed.js";

/** The server that sent the page. */
export class ServerSource {
  keepsAddress = true;
  line = new Line((message) => this.#send(message));
  #socket = null;
  #waiting = [];

  scene() { return this.#get("scene.bin"); }
  matrix() { return this.#get("matrix.bin"); }
  layer(name) { return this.#get(`layer/${name}.bin`); }
  async frame(number) { return unpack(await this.#get(`frame/${number}.bin`)); }

  async #get(name) {
    const answer = await fetch(name);
    if (!answer.ok) throw new Error(await answer.text());
    return answer.arrayBuffer();
  }

  /** Send a message, as soon as the server listens. */
  #send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(message);
    else this.#waiting.push(message);
  }

  /** Tell the viewer what the server answers, and when it ends. */
  watch(viewer) {
    const address = new URL("socket", location.href).href.replace(/^http/, "ws").replace(/#.*/, "");
    const socket = this.#socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { for (const message of this.#waiting.splice(0)) socket.send(message); };
    socket.onmessage = ({ data }) => this.line.receive(data);
    const left = viewer.matrix.remote ? "Painting needs it" : "What is on this page still works";
    // 1008 is WebSocket's code for "you broke the rules".
    socket.onclose = ({ code }) => viewer.notice(code === 1008
      ? `The server did not understand this page. ${left}; reload it for the rest.`
      : `The server has ended. ${left}; start \`lightmatrix view\` again for the rest.`);
  }
}

/** The page itself: elements <script type="text/plain"> with base64. */
export class PageSource {
  keepsAddress = true;
  async scene() { return this.#read("scene"); }
  async matrix() { return this.#read("matrix"); }
  async layer(name) { return this.#read(`layer-${name}`); }
  async frame(number) { return unpack(this.#read(`frame-${number}`)); }
  watch() {}

  #read(name) {
    const element = document.getElementById(`data-${name}`);
    return Uint8Array.from(atob(element.textContent.trim()), (letter) => letter.charCodeAt(0)).buffer;
  }
}
