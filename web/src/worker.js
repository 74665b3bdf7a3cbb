// Finds one hand in pictures with MediaPipe Hands, and draws both.
//
// Messages are first {canvas}, then {frame: VideoFrame or ImageBitmap, t}. Answers are {ready}, then {t, hand, aspect}
// for each frame, or {failure}; `hand` is null or {world: 21 × [x, y, z] m, image: 21 × [u, v], score, side}.

import { drawSkeleton } from "./skeleton.js";

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

// MediaPipe names sides as in a mirrored picture.
const SIDE = { Left: "right", Right: "left" };
const WIDTH = 480; // of the pictures, pixels
// Pictures stay in the processor's memory, where cameras put theirs.
const IN_MEMORY = { willReadFrequently: true };
const picture = new OffscreenCanvas(1, 1).getContext("2d", IN_MEMORY);
let shown = null;
let found = null;

async function open() {
  const files = new URL("hands/", self.location).href;
  importScripts(`${files}hands.js`);
  const hands = new self.Hands({ locateFile: (file) => files + file });
  hands.setOptions({ maxNumHands: 1, modelComplexity: 0, useCpuInference: true });
  hands.onResults((results) => (found = results));
  await hands.initialize();
  return hands;
}

const opening = open();
opening.then(
  () => postMessage({ ready: true }),
  (error) => postMessage({ failure: String(error) }),
);

onmessage = async ({ data: { canvas, width, frame, t } }) => {
  if (canvas) {
    shown = canvas.getContext("2d", IN_MEMORY);
    canvas.width = width;
    return;
  }
  try {
    const hands = await opening;
    const image = read(frame);
    found = null;
    await hands.send({ image });
    const hand = first(found);
    postMessage({ t, hand, aspect: image.width / image.height });
    shown.drawImage(picture.canvas, 0, 0, shown.canvas.width, shown.canvas.height);
    if (hand) drawSkeleton(shown, hand.image);
  } catch (error) {
    postMessage({ failure: String(error) });
  }
};

function read(frame) {
  const { displayWidth = frame.width, displayHeight = frame.height } = frame;
  const height = Math.round((WIDTH * displayHeight) / displayWidth);
  fit(picture.canvas, WIDTH, height);
  fit(shown.canvas, shown.canvas.width, Math.round((shown.canvas.width * height) / WIDTH));
  picture.drawImage(frame, 0, 0, WIDTH, height);
  frame.close();
  return picture.getImageData(0, 0, WIDTH, height);
}

function fit(canvas, width, height) {
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
}

function first(results) {
  const world = results?.multiHandWorldLandmarks?.[0];
  if (!world) return null;
  const { score, label } = results.multiHandedness[0];
  return {
    world: world.map(({ x, y, z }) => [x, y, z]),
    image: results.multiHandLandmarks[0].map(({ x, y }) => [x, y]),
    score: Math.min(score, 1),
    side: SIDE[label],
  };
}
