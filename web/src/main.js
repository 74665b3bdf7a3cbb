// Joins the devices, the connection, the view and the panel.

import { Camera } from "./camera.js";
import { Connection } from "./connection.js";
import { Headset, headsetMode } from "./headset.js";
import { show, showChoices } from "./panel.js";
import { Pointer } from "./pointer.js";
import { Replay } from "./replay.js";
import { best, remember } from "./times.js";
import { View } from "./view.js";
import { Steady } from "./words.js";

const VERSION = 1;
// How long the page shows why a request was refused.
const REFUSAL_MS = 4000;
// Browsers' own messages differ, and some are empty.
const REASONS = {
  NotAllowedError: "the browser does not allow it",
  NotFoundError: "none was found",
  NotReadableError: "another program uses it",
  OverconstrainedError: "none was found",
};
const element = (id) => document.getElementById(id);
const UNSEEN = { seen: false, side: "", score: 0, rate: 0, delay: 0 };

/** @type {import("./words.js").Model} */
const model = {
  connected: false,
  welcome: null,
  state: null,
  device: null,
  failure: "",
  refusal: "",
  leaving: null,
  hand: UNSEEN,
  best: [],
  grip: null,
};
if (!document.createElement("canvas").getContext("webgl2")) {
  element("no-webgl").hidden = false;
  throw new Error("the page needs WebGL 2");
}
const view = new View(element("view"));
let scene = null;

const replay = new Replay(view, refresh);
const steady = new Steady(refresh);

function refresh() {
  const { headline, detail } = show({ ...model, replaying: replay.running }, steady);
  view.setWords(headline, detail);
}

const connection = new Connection({
  onClose(refusal) {
    Object.assign(model, { connected: false, welcome: null, state: null, leaving: null, refusal });
    refresh();
  },
  onMessage(message) {
    if (message.type === "welcome") receiveWelcome(message);
    else if (message.type === "state") receiveState(message);
    else if (message.type === "refused") receiveRefusal(message);
    refresh();
  },
  onPoses(values) {
    if (scene === null || replay.running) return;
    view.setPoses(values);
    const { engaged, simulated_person, outcome } = model.state ?? {};
    if ((engaged || simulated_person) && !outcome?.over) replay.add(values);
  },
});

function hello() {
  connection.send({
    type: "hello",
    version: VERSION,
    role: "operator",
    device: model.device ?? "camera",
    side: model.welcome.side,
    hand_length: Number(element("length").value) / 100 || null,
  });
}

/** The first welcome says of which side the robot is; the answer to `hello` whether this page has the controls. */
function receiveWelcome(welcome) {
  const before = model.welcome;
  Object.assign(model, { connected: before !== null, welcome });
  showChoices(welcome);
  // Another robot may have the other side, so whoever moved the last one is asked anew.
  const another = before && ["hand", "side", "mount"].some((name) => before[name] !== welcome[name]);
  if (!before || (another && before.role === "operator" && welcome.role === "spectator")) hello();
}

function receiveRefusal({ text }) {
  model.leaving = null;
  model.refusal = text;
  clearTimeout(receiveRefusal.timeout);
  receiveRefusal.timeout = setTimeout(() => {
    model.refusal = "";
    refresh();
  }, REFUSAL_MS);
}

function receiveState(state) {
  const over = state.outcome?.over && !model.state?.outcome?.over && state.scene === model.state?.scene;
  model.state = state;
  if (over && state.outcome.success && !state.simulated_person) remember(model.welcome.hand, state);
  model.best = best(model.welcome.hand, state);
  view.highlight(cuedBody(state.outcome?.phase));
  if (state.scene === scene) return;
  scene = state.scene;
  model.leaving = null;
  replay.clear();
  fetch("scene")
    .then((response) => response.json())
    .then((description) => view.load(description));
}

/** The body of the key that shall be pressed. */
const cuedBody = (phase) => phase?.replace(/^key (\d+)$/, "keys::cap_$1");

// Devices

/** Takes a hand from a device: `fields` of its message, or null while no hand is seen. */
function receiveHand(t, fields, seen) {
  const previous = model.hand;
  const usable = fields && model.welcome?.role === "operator" && seen.side === model.welcome.side;
  if (usable) connection.sendHand({ type: model.device, t, ...fields });
  else if (previous.usable) connection.send({ type: "lost", t });
  const interval = t - previous.t;
  const rate = interval < 1 ? previous.rate + 0.1 * (1 / interval - previous.rate) : 0;
  model.hand = fields ? { seen: true, usable, t, rate, ...seen } : { ...UNSEEN, t, rate };
  if (Boolean(previous.usable) !== Boolean(usable)) refresh();
}

const camera = new Camera(
  element("mirror"),
  ({ t, hand, aspect, delay }) => {
    if (!hand) return receiveHand(t, null);
    const { side, ...fields } = hand;
    receiveHand(t, { ...fields, aspect }, { side, score: fields.score, delay });
  },
  stopUsing,
);

const headset = new Headset(
  view,
  ({ t, side, joints }) =>
    receiveHand(t, joints && { joints }, { side, score: 1, delay: performance.now() / 1000 - t }),
  () => stopUsing(),
);

const pointer = new Pointer(element("view"), ({ t, ...fields }) => {
  const { grip, closed, z } = fields;
  if (model.grip?.name !== grip || model.grip.closed !== closed) {
    model.grip = { name: grip, closed };
    refresh();
  }
  element("reach").value = z;
  receiveHand(t, fields, { side: model.welcome?.side, score: 1, delay: 0 });
});

function stopUsing(failure = "") {
  camera.stop();
  pointer.stop();
  view.controls.enabled = true;
  if (model.hand.usable) receiveHand(performance.now() / 1000, null);
  Object.assign(model, { device: null, failure, hand: UNSEEN, grip: null });
  refresh();
}

async function use(device, start) {
  const previous = model.device;
  if (previous === "headset") return headset.stop();
  stopUsing();
  if (previous === "simulated") setUp();
  if (previous === device) return;
  model.device = device;
  if (device === "simulated") setUp();
  if (model.welcome) hello();
  refresh();
  await start().catch(({ name, message }) => stopUsing(`The ${device} cannot be used: ${REASONS[name] ?? message}.`));
}

element("pointer").onclick = () =>
  use("pointer", async () => {
    view.controls.enabled = false;
    pointer.start();
  });
for (const button of document.querySelectorAll("[data-grip]")) {
  const toggleGrip = () => pointer.toggle(button.dataset.grip);
  button.onclick = toggleGrip;
  // Browsers may send no click after a long press, nor while a page glides.
  button.addEventListener("touchend", (event) => {
    event.preventDefault(); // the click would toggle once more
    toggleGrip();
  });
}
element("reach").oninput = ({ target }) => pointer.reach(Number(target.value));

/** The server changes between its simulated person and one's own hand. */
function setUp() {
  model.leaving = scene;
  if (model.device === null && model.welcome) hello();
}

element("simulated").onclick = () => use("simulated", async () => {});
// The server plays the recording.
element("recording-hand").onclick = () =>
  use("recording", async () => {
    model.hand = { ...UNSEEN, seen: true, side: model.welcome?.side, score: 1, rate: 60 };
    refresh();
  });

const useCamera = () => use("camera", () => camera.start());
element("camera").onclick = useCamera;
navigator.permissions
  ?.query({ name: "camera" })
  .then(({ state }) => state === "granted" && useCamera())
  .catch(() => {});

headsetMode().then((mode) => {
  element("headset").hidden = mode === null;
  if (mode === null)
    element("no-headset").textContent = navigator.xr ? "No headset found." : "This browser does not support headsets.";
  element("headset").onclick = () => use("headset", () => headset.start(mode, () => model.welcome?.side));
});

// A page that is not shown gets no pictures.
document.addEventListener("visibilitychange", () => {
  if (document.hidden && model.hand.usable) receiveHand(performance.now() / 1000, null);
});

// Controls

async function toggle() {
  if (element("engage").disabled) return;
  if (model.device === "simulated") return element("simulated").click();
  if (model.welcome.role === "spectator") return hello();
  if (model.state?.engaged) return connection.send({ type: "disengage" });
  if (model.welcome.robot === "real") {
    if (!(await confirmRealRobot())) return;
    connection.send({ type: "engage" }); // a real robot wants it twice
  }
  connection.send({ type: "engage" });
}

function confirmRealRobot() {
  const dialog = element("real-robot");
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((resolve) => (dialog.onclose = () => resolve(dialog.returnValue === "engage")));
}

function reset(choice = {}) {
  connection.send({ type: "reset", ...choice });
  model.leaving = scene;
  refresh();
}

element("engage").onclick = toggle;
element("reset").onclick = () => reset();
for (const [id, name] of Object.entries({ hand: "hand", mount: "mount", "task-name": "task", object: "object" }))
  element(id).onchange = ({ target }) => {
    reset({ [name]: target.value });
    target.blur();
  };
element("keep").onchange = refresh;
element("record").onclick = () =>
  connection.send(model.state?.recording ? { type: "stop" } : { type: "record", keep: true });

for (const button of document.querySelectorAll("[data-view]"))
  button.onclick = () => {
    view.look(button.dataset.view);
    for (const each of document.querySelectorAll("[data-view]")) each.ariaPressed = String(each === button);
  };
element("reset-view").onclick = () => view.look();
element("again").onclick = () => reset();
element("watch").onclick = () => (replay.running ? replay.stop() : replay.play());
element("clip").onclick = async ({ target }) => {
  target.disabled = true;
  const file = await replay.film();
  target.disabled = false;
  if (!file) {
    target.textContent = "No clip could be recorded";
    target.disabled = true;
    return;
  }
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(file), download: file.name });
  link.click();
  // A browser reads the file after the click; revoked at once, what it saves is empty.
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
};

// Browsers that block cookies throw at any use of the storage; then the length is not remembered.
try {
  element("length").value = localStorage.getItem("hand_length") ?? "";
} catch {}
element("length").onchange = ({ target }) => {
  try {
    localStorage.setItem("hand_length", target.value);
  } catch {}
  if (model.welcome) hello();
};

// Space always engages and disengages, whichever button was used last; Enter presses buttons.
document.addEventListener("keydown", (event) => {
  const { key, target, repeat } = event;
  if (element("real-robot").open || target.matches("input, select")) return;
  if (key === " ") event.preventDefault();
  if (repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  if (key === " ") toggle();
  if (key === "Escape" && model.state?.engaged) connection.send({ type: "disengage" });
  if (key.toLowerCase() === "r" && !element("reset").disabled) reset();
});
document.addEventListener("keyup", (event) => {
  if (event.key === " " && event.target.matches("button")) event.preventDefault();
});

refresh();
