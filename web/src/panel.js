// The page's words and controls outside the 3D view.

import { quality, situation } from "./words.js";

// Steps of the tasks that have some; others show what to do now.
const STEPS = { grasp: ["reach", "touch", "grasp", "lift", "hold"] };
const END = { thrown: "Thrown" };
const DEVICE_WORDS = {
  headset: "The robot is in your headset.",
  pointer: "The mouse moves the coloured hand.",
  recording: "A recorded hand moves; without one, a synthetic hand at play.",
};
const element = (id) => document.getElementById(id);

/** Shows a `Model`; returns the situation that it shows. */
export function show(model, steady) {
  const { welcome, state, hand, device, failure } = model;
  const now = steady.step(situation(model), Boolean(state?.engaged));
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
  write("start-words", failure || DEVICE_WORDS[device] || element("start").dataset.words);
  write("pointer", device === "pointer" ? "Stop using the mouse" : "Use the mouse");
  write("recording-hand", device === "recording" ? "Stop the recorded hand" : "Play a recorded hand");
  element("start").dataset.device = device ?? "";
  element("pointer-words").hidden = device !== "pointer";
  write("grip", `Now: ${model.grip === "hand" ? "whole hand" : model.grip}.`);
  write("camera", device === "camera" ? "Stop the camera" : "Use the camera");
  write("headset", device === "headset" ? "Leave headset" : "Use the headset");
  element("camera").classList.toggle("primary", device === null);
  const { value, words } = quality(model);
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
  showResult(state, model.best);
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

function showResult(state, times) {
  const outcome = state?.outcome;
  element("result").hidden = !outcome?.over;
  if (!outcome?.over) return;
  const { success, seconds, score } = outcome;
  element("result").dataset.outcome = success ? "success" : "failure";
  write("result-title", success ? `Done in ${seconds.toFixed(1)} s` : "Not this time");
  write("result-words", success ? "Your best times here:" : `You came ${Math.round(100 * score)} % of the way.`);
  const items = success ? times.map((time) => `${time.toFixed(1)} s${time === seconds ? " (now)" : ""}`) : [];
  if (items.join() === Array.from(element("best").children, ({ textContent }) => textContent).join()) return;
  element("best").replaceChildren(
    ...items.map((textContent) => Object.assign(document.createElement("li"), { textContent })),
  );
}

function counts({ received, late, refused, spectators }) {
  const watching = spectators ? ` · ${spectators} watching` : "";
  const faults = late + refused ? `, ${late} too late, ${refused} not usable` : "";
  return `${received} pictures of your hand used${faults}${watching}`;
}

/** Writes only what has changed, as screen readers read every change. */
function write(target, text) {
  const node = typeof target === "string" ? element(target) : target;
  if (node.textContent !== text) node.textContent = text;
}

const sentenceCase = (text) => text && text[0].toUpperCase() + text.slice(1);
