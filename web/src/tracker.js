// A worker that finds one hand in pictures with MediaPipe Hands.
//
// Messages in: {picture: ImageBitmap, t}. Messages out: {ready}, {t, hand, seconds} or {failure}; `hand` is null
// or {world: 21 × [x, y, z] m, image: 21 × [u, v], score, side}.

const files = new URL("hands/", self.location).href;

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

let found = null;

async function open() {
  importScripts(`${files}hands.js`);
  const hands = new self.Hands({ locateFile: (file) => files + file });
  // Inference on the CPU is fast on every machine, and leaves the GPU to the view.
  hands.setOptions({ maxNumHands: 1, modelComplexity: 1, useCpuInference: true });
  hands.onResults((results) => (found = results));
  await hands.initialize();
  return hands;
}

const opening = open();
opening.then(
  () => postMessage({ ready: true }),
  (error) => postMessage({ failure: String(error) }),
);

onmessage = async ({ data: { picture, t } }) => {
  const begin = performance.now();
  try {
    const hands = await opening;
    found = null;
    await hands.send({ image: picture });
    postMessage({ t, hand: first(found), seconds: (performance.now() - begin) / 1000 });
  } catch (error) {
    postMessage({ failure: String(error) });
  } finally {
    picture.close();
  }
};

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
