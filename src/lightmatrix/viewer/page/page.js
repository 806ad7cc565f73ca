// The module of a page of its own, with a server or as one file.

import { show } from "./show.js";
import { PageSource, ServerSource } from "./sources.js";

const place = document.querySelector("main[data-viewer]");
globalThis.lightmatrixViewer = await show(place, place.dataset.viewer === "server" ? new ServerSource() : new PageSource());
