// The page's words and controls outside the 3D view.

import { quality, situation } from "./words.js";

// Steps of the tasks that have some; others show what to do now.
const STEPS = { grasp: ["reach", "touch", "grasp", "lift", "hold"] };
const END = { thrown: "Thrown" };
const IN_HEADSET = "The robot is in your headset.";
const element = (id) => document.getElementById(id);

/** Shows a `Model`; returns its situation. */
export function show(model) {
  const { welcome, state, hand, device, failure } = model;
  const now = situation(model);
  const { body } = document;
  body.dataset.state = now.name;
  body.toggleAttribute("data-engaged", Boolean(state?.engaged));
  body.toggleAttribute("data-holding", Boolean(state?.engaged && !state.following));
  body.toggleAttribute("data-recording", Boolean(state?.recording));
  write("connection", !model.connected ? "Connecting" : welcome?.robot === "real" ? "Real robot" : "Simulation");
  write(element("headline").querySelector("strong"), now.headline);
  write(element("headline").querySelector("span"), now.detail);
  element("fist").style.strokeDasharray = `${state?.fist ?? 0} 1`;

  element("start").hidden = device === "camera";
  element("mirror").hidden = device !== "camera";
  write("start-words", failure || (device === "headset" ? IN_HEADSET : element("start").dataset.words));
  write("camera", device === "camera" ? "Stop the camera" : "Use the camera");
  write("headset", device === "headset" ? "Leave headset" : "Use the headset");
  element("camera").classList.toggle("primary", device === null);
  const { value, words } = quality(hand);
  element("quality").value = value;
  write("quality-words", words);
  const delay = hand.delay + (state?.delay.median ?? NaN);
  write("delay", hand.seen && delay > 0 ? `${Math.round(1000 * delay)} ms` : "");

  const operator = model.connected && welcome?.role === "operator";
  const free = welcome?.role === "spectator" && state?.operator === false;
  const ready = operator && (state?.engaged || (hand.seen && model.leaving === null));
  element("engage").disabled = !free && !ready;
  write(element("engage").querySelector("span"), free ? "Take the controls" : state?.engaged ? "Disengage" : "Engage");
  const fixed = !operator || !state?.task;
  element("reset").disabled = element("task-name").disabled = element("object").disabled = fixed;
  if (state?.task && document.activeElement !== element("task-name") && document.activeElement !== element("object")) {
    element("task-name").value = state.task;
    showObjects(welcome.tasks[state.task]);
    element("object").value = state.object;
  }
  write("purpose", sentenceCase(welcome?.instructions[state?.task]) ?? "");

  write("map", sentenceCase(welcome?.map) ?? "");
  element("record").disabled = !operator || !(state?.recording || element("keep").checked);
  write("record", state?.recording ? "Stop" : "Record");
  write("recording", state?.recording ?? "");
  write("counts", state ? counts(state) : "");

  showTask(state);
  return now;
}

/** Fills the choice of tasks. */
export const showTasks = (tasks) => fill("task-name", Object.keys(tasks));

function showObjects(names) {
  element("object").hidden = names.length < 2;
  fill("object", names);
}

function fill(id, names) {
  const { options } = element(id);
  if (names.join() === Array.from(options, ({ value }) => value).join()) return;
  element(id).replaceChildren(...names.map((name) => new Option(sentenceCase(name.replaceAll("_", " ")), name)));
}

function showTask(state) {
  const outcome = state?.outcome;
  element("task").hidden = !outcome;
  if (!outcome) return;
  const { phase, score, seconds, over, success } = outcome;
  element("task").dataset.outcome = !over ? "open" : success ? "success" : "failure";
  write("timer", `${(seconds ?? state.time).toFixed(1)} s`);
  const steps = STEPS[state.task] ?? (over ? [] : [phase === "none" ? "wait" : phase]);
  const done = phase === "done" ? steps.length : Math.max(steps.indexOf(phase), 0);
  const items = steps.map((name, i) => {
    const item = Object.assign(document.createElement("li"), { textContent: sentenceCase(name) });
    item.classList.toggle("past", i < done);
    if (i === done && !over) item.ariaCurrent = "step";
    return item;
  });
  if (over) {
    const end = document.createElement("li");
    end.textContent = success ? "Done" : (END[phase] ?? `${Math.round(100 * score)} %`);
    end.ariaCurrent = "step";
    items.push(end);
  }
  element("phases").replaceChildren(...items);
}

function counts({ received, late, refused, spectators }) {
  const watching = spectators ? ` · ${spectators} watching` : "";
  return `${received} hands, ${late} late, ${refused} refused${watching}`;
}

/** Writes only what has changed, as screen readers read every change. */
function write(target, text) {
  const node = typeof target === "string" ? element(target) : target;
  if (node.textContent !== text) node.textContent = text;
}

const sentenceCase = (text) => text && text[0].toUpperCase() + text.slice(1);
