// How a viewer begins.

import { Matrix } from "./matrix.js";
import { unpack } from "./packed.js";
import { RemoteMatrix } from "./remote.js";
import { Viewer } from "./viewer.js";

/** Show the viewer in an element. */
export async function show(root, source) {
  try {
    const scene = unpack(await source.scene());
    const matrix = scene.header.remote
      ? new RemoteMatrix(scene.header, source.line)
      : new Matrix(unpack(await source.matrix()), scene.header);
    const viewer = new Viewer(root, source, scene, matrix);
    source.watch(viewer);
    return viewer;
  } catch (error) {
    root.textContent = error.message;
    root.setAttribute("role", "alert");
    throw error;
  }
}
