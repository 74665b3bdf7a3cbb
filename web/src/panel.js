// The page's words and controls outside the 3D view.

import { quality, situation } from "./words.js";

// Steps of the tasks that have some; others show what to do now.
const STEPS = { grasp: ["reach", "touch", "grasp", "lift", "hold"] };
const END = { thrown: "Thrown" };
const DEVICE_WORDS = {
  headset: "The robot is in your headset.",
  recording: "A recorded hand moves or, if there is none, a synthetic one.",
  simulated: "A simulated person does the task.",
};
// A screen that only fingers touch, such as a phone's.
const POINTER = matchMedia("(hover: none)").matches ? "your finger" : "the mouse";
const HANDS = { allegro: "Allegro", leap: "LEAP" };
const MOUNTS = { arm: "On an arm", floating: "Floating" };
const CHOICES = ["hand", "mount", "task-name", "object"];
const element = (id) => document.getElementById(id);

/** Shows a `Model`; returns the situation that it shows. */
export function show(model, steady) {
  const { welcome, state, hand, device, failure } = model;
  const now = steady.step({ ...situation(model), ...quality(model) }, Boolean(state?.engaged));
  const { body } = document;
  body.dataset.state = now.name;
  body.toggleAttribute("data-engaged", Boolean(state?.engaged));
  body.toggleAttribute("data-holding", Boolean(state?.engaged && !state.following));
  body.dataset.device = device ?? "";
  body.toggleAttribute("data-replaying", model.replaying);
  body.toggleAttribute("data-recording", Boolean(state?.recording));
  write("connection", !model.connected ? "Connecting" : welcome?.robot === "real" ? "Real robot" : "Simulation");
  write(element("headline").querySelector("strong"), now.headline);
  write(element("headline").querySelector("span"), now.detail);
  element("fist").style.strokeDasharray = `${state?.fist ?? 0} 1`;

  element("start").hidden = device === "camera";
  element("mirror").hidden = device !== "camera";
  write("start-words", failure || DEVICE_WORDS[device] || element("start").dataset.words);
  write("pointer", device === "pointer" ? `Stop using ${POINTER}` : `Use ${POINTER}`);
  write("recording-hand", device === "recording" ? "Stop the recorded hand" : "Play a recorded hand");
  write("simulated", device === "simulated" ? "Stop watching" : "Watch a simulated person");
  element("start").dataset.device = device ?? "";
  element("pointer-words").hidden = device !== "pointer";
  element("grips").hidden = device !== "pointer";
  for (const button of document.querySelectorAll("[data-grip]")) {
    const chosen = button.dataset.grip === model.grip?.name;
    button.toggleAttribute("data-chosen", chosen);
    button.ariaPressed = String(chosen && model.grip.closed);
  }
  write("camera", device === "camera" ? "Stop the camera" : "Use the camera");
  write("headset", device === "headset" ? "Leave headset" : "Use the headset");
  element("camera").classList.toggle("primary", device === null);
  element("quality").value = now.value;
  write("quality-words", now.words);
  const delay = hand.delay + (state?.delay.median ?? NaN);
  write("delay", hand.seen && delay > 0 ? `${Math.round(1000 * delay)} ms` : "");

  const operator = model.connected && welcome?.role === "operator";
  const free = welcome?.role === "spectator" && state?.operator === false;
  const watched = operator && device === "simulated";
  const ready = operator && (state?.engaged || watched || (hand.seen && model.leaving === null));
  element("engage").disabled = !free && !ready;
  const act = watched ? "Stop" : state?.engaged ? "Disengage" : "Engage";
  write(element("engage").querySelector("span"), free ? "Take the controls" : act);
  const fixed = !operator || !state?.task;
  for (const id of ["reset", ...CHOICES]) element(id).disabled = fixed;
  if (state?.task && !CHOICES.includes(document.activeElement?.id)) {
    element("hand").value = welcome.hand;
    element("mount").value = state.mount;
    element("mount").disabled ||= state.mount !== welcome.mount; // the task's own
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
  showResult(state, model.best, model.replaying);
  return now;
}

/** Fills the choices of hand, mount and task. */
export function showChoices({ hands, mounts, tasks }) {
  element("robot").hidden = hands.length < 2 && mounts.length < 2;
  fill("hand", hands, handWords);
  fill("mount", mounts, (name) => MOUNTS[name] ?? plainName(name));
  fill("task-name", Object.keys(tasks));
}

function showObjects(names) {
  element("object").hidden = names.length < 2;
  fill("object", names);
}

const plainName = (name) => sentenceCase(name.replaceAll("_", " "));

/** A hand's name in words: "LEAP, right". */
function handWords(name) {
  const [, model, side] = name.match(/^(.*)_(left|right)$/) ?? [];
  return model ? `${HANDS[model] ?? plainName(model)}, ${side}` : plainName(name);
}

function fill(id, names, words = plainName) {
  const { options } = element(id);
  if (names.join() === Array.from(options, ({ value }) => value).join()) return;
  element(id).hidden = names.length === 0;
  element(id).replaceChildren(...names.map((name) => new Option(words(name), name)));
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

function showResult(state, times, replaying) {
  const outcome = state?.outcome;
  element("result").hidden = !outcome?.over;
  if (!outcome?.over) return;
  const { success, seconds, score, reason } = outcome;
  const simulated = state.simulated_person;
  element("result").dataset.outcome = success ? "success" : "failure";
  write("result-title", success ? `Done in ${seconds.toFixed(1)} s` : `Not this time: ended after ${state.time.toFixed(1)} s`);
  const who = simulated ? "The simulated person" : "You";
  const way = `${who} came ${Math.round(100 * score)} % of the way.`;
  const done = simulated ? "The simulated person did it. Now you?" : "";
  write("result-words", success ? done : reason ? `${way} ${sentenceCase(reason)}.` : way);
  write("again", simulated ? "Watch another" : "Try again");
  write("watch", replaying ? "Stop the replay" : "Watch the replay");
  // A simulated person's times are not one's own.
  const items = simulated ? [] : times.map((time) => `${time.toFixed(1)} s${time === seconds ? " (now)" : ""}`);
  write("best-words", items.length ? "Your best times here:" : "");
  if (items.join() === Array.from(element("best").children, ({ textContent }) => textContent).join()) return;
  element("best").replaceChildren(
    ...items.map((textContent) => Object.assign(document.createElement("li"), { textContent })),
  );
}

function counts({ received, late, refused, spectators }) {
  const faults = late + refused ? `, ${late} too late, ${refused} not usable` : "";
  const hands = received + refused ? `${received} positions of your hand used${faults}` : "";
  return [hands, spectators ? `${spectators} watching` : ""].filter(Boolean).join(" · ");
}

/** Writes only what has changed, as screen readers read every change. */
function write(target, text) {
  const node = typeof target === "string" ? element(target) : target;
  if (node.textContent !== text) node.textContent = text;
}

const sentenceCase = (text) => text && text[0].toUpperCase() + text.slice(1);
