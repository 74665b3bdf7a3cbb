// Runs the tracker in a worker.

import { startTracker } from "./tracker.js";

// MediaPipe's own support of workers loads its models as scripts. With these two names it takes the page's way.
self.window = self;
self.document = {
  createElement(tag) {
    if (tag === "canvas") return new OffscreenCanvas(1, 1);
    return {
      setAttribute(name, value) {
        this[name] = value;
      },
      addEventListener(event, listener) {
        this[event] = listener;
      },
    };
  },
  body: {
    appendChild(script) {
      importScripts(script.src);
      script.load();
    },
  },
};

const take = startTracker((message) => postMessage(message), importScripts);
onmessage = ({ data }) => take(data);
