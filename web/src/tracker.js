// Finds one hand in pictures with MediaPipe Hands, and draws both.

import { drawSkeleton } from "./skeleton.js";

// MediaPipe names sides as in a mirrored picture.
const SIDE = { Left: "right", Right: "left" };

// Width of the pictures, pixels: MediaPipe copies each picture through WebGL, which takes the time of its pixels
// where the processor draws. It finds hands in 192 pixels; more are for hands that are far from the camera.
const WIDTH = 480;
const SOFTWARE_WIDTH = 256;
// Pictures stay in the processor's memory, where cameras put theirs.
const IN_MEMORY = { willReadFrequently: true };
const picture = new OffscreenCanvas(1, 1).getContext("2d", IN_MEMORY);
let shown = null;
let width = WIDTH;

let found = null;

async function open(load) {
  const files = new URL("hands/", self.location).href;
  await load(`${files}hands.js`);
  const hands = new self.Hands({ locateFile: (file) => files + file });
  // Inference on the CPU is fast on every machine, and leaves the GPU to the view.
  hands.setOptions({ maxNumHands: 1, modelComplexity: 0, useCpuInference: true });
  hands.onResults((results) => (found = results));
  await hands.initialize();
  return hands;
}

/**
 * Starts MediaPipe.
 *
 * @param {(message: object) => void} post gets {ready}, {t, hand, aspect} or {failure}; `hand` is null or
 *   {world: 21 × [x, y, z] m, image: 21 × [u, v], score, side}.
 * @param {(url: string) => any} load runs a script.
 * @returns {(message: object) => void} takes {canvas, software} first, then {frame: VideoFrame or ImageBitmap, t}.
 */
export function startTracker(post, load) {
  const opening = open(load);
  opening.then(
    () => post({ ready: true }),
    (error) => post({ failure: String(error) }),
  );
  return async ({ canvas, software, frame, t }) => {
    if (canvas) {
      width = software ? SOFTWARE_WIDTH : WIDTH;
      shown = canvas.getContext("2d", IN_MEMORY);
      return;
    }
    try {
      const hands = await opening;
      found = null;
      draw(frame);
      await hands.send({ image: picture.canvas });
      const hand = first(found);
      shown.drawImage(picture.canvas, 0, 0);
      if (hand) drawSkeleton(shown, hand.image);
      post({ t, hand, aspect: picture.canvas.width / picture.canvas.height });
    } catch (error) {
      post({ failure: String(error) });
    }
  };
}

function draw(frame) {
  const { displayWidth = frame.width, displayHeight = frame.height } = frame;
  const height = Math.round((width * displayHeight) / displayWidth);
  for (const { canvas } of [picture, shown])
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  picture.drawImage(frame, 0, 0, width, height);
  frame.close();
}

function first(results) {
  const world = results?.multiHandWorldLandmarks?.[0];
  if (!world) return null;
  results.image?.close?.();
  const { score, label } = results.multiHandedness[0];
  return {
    world: world.map(({ x, y, z }) => [x, y, z]),
    image: results.multiHandLandmarks[0].map(({ x, y }) => [x, y]),
    score: Math.min(score, 1),
    side: SIDE[label],
  };
}
