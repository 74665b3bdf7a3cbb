// What the page says, from what it knows.

/**
 * @typedef {object} Model
 * @property {boolean} connected
 * @property {object | null} welcome the server's last message of this type
 * @property {object | null} state the server's last message of this type
 * @property {"camera" | "headset" | "pointer" | "recording" | "simulated" | null} device
 * @property {string} failure why the device cannot be used, or ""
 * @property {string} refusal of the last message, or ""
 * @property {number | null} leaving number of the scene that a reset ends, until the next one is there
 * @property {{name: string, closed: boolean} | null} grip of the pointer
 * @property {boolean} replaying
 * @property {{seen: boolean, side: string, score: number, rate: number, delay: number}} hand as the device sees it
 */

/**
 * @param {Model} model
 * @returns {{name: "connecting" | "waiting" | "tracking" | "engaged" | "lost", headline: string, detail: string}}
 */
export function situation({ connected, welcome, state, device, failure, hand, refusal, leaving }) {
  if (!connected || !welcome)
    return location.hash
      ? refusal
        ? say("connecting", "Not connected", sentence(refusal))
        : say("connecting", "Connecting", "Waiting for geort-drake live on this address.")
      : say("connecting", "The address is incomplete", "Open the whole address that geort-drake live printed.");
  const { side } = welcome;
  if (welcome.role === "spectator")
    return state?.operator === false
      ? say("waiting", "Nobody has the controls", "Take them to move the robot.")
      : say("waiting", "You are watching", "Another page has the controls.");
  if (device === "simulated") return watched(state, leaving);
  if (leaving !== null) return say("waiting", "Setting up", "The robot holds until the new scene is ready.");
  const virtual = device === "pointer" || device === "recording";
  const wrong = hand.seen && hand.side !== side;
  const seen = hand.seen && !wrong;
  const { engaged, following, outcome } = state ?? {};
  if (outcome?.over)
    return outcome.success
      ? say(engaged ? "engaged" : "tracking", "Done", "Press Reset for another try.")
      : say(engaged ? "engaged" : "tracking", "Not this time", "Press Reset to try again.");
  if (engaged && !seen) return say("lost", "Hand lost", `The robot holds until it sees your ${side} hand again.`);
  if (engaged && !following && state.slow) return say("engaged", "The robot waits", SLOW);
  if (engaged && state.fist > 0) return say("engaged", "Keep your fist closed to stop", "The robot holds when the ring is full.");
  if (engaged)
    return following
      ? say("engaged", "The robot follows your hand", refusal || (state.slow ? SLOW : plain(state.status)))
      : say("engaged", "The robot waits", refusal || plain(state.status, virtual));
  if (!device && failure) return say("waiting", "No hand to follow", "Choose another way to move the robot.");
  if (!device) return say("waiting", `Hold up your ${side} hand`, "Use the camera, or choose another way to move the robot.");
  if (device === "camera" && hand.t === undefined)
    return say("waiting", "The camera is starting", "It takes a moment until your hand can be found.");
  if (wrong)
    return say("waiting", `That is your ${hand.side} hand`, `This robot has a ${side} one. Show your ${side} hand.`);
  if (!seen && virtual) return say("waiting", "One moment", "The coloured hand appears beside the robot's.");
  if (!seen) return say("waiting", `Hold up your ${side} hand`, "Show the whole hand, with the palm to the camera.");
  if (refusal) return say("tracking", "Not yet", refusal);
  if (welcome.robot === "real") return say("tracking", "Press Engage to take control", "The real robot will move.");
  if (virtual) return say("tracking", "Press Engage to begin", "The robot then copies the coloured hand.");
  return state?.fist > 0
    ? say("tracking", "Keep your fist closed", "The robot follows when the ring is full.")
    : say("tracking", "Hold a fist to take control", "Or press Engage. The robot moves as your hand does.");
}

function watched(state, leaving) {
  if (leaving !== null || !state?.simulated_person)
    return say("waiting", "The simulated person is getting ready", "Planning and practice take up to half a minute the first time, and longer on a busy computer.");
  const { over, success } = state.outcome;
  if (over) return say("tracking", success ? "Done" : "Not this time", "Watch another, or move the robot yourself.");
  return say("engaged", "A simulated person moves the robot", state.slow ? SLOW : "The coloured hand is theirs.");
}

const SLOW =
  "This computer is too slow. Close other programs and tabs, or make this window smaller.";

const say = (name, headline, detail) => ({ name, headline, detail });

/** What the server's states mean to a person; the first entry whose words a state begins with counts. */
const PLAIN = [
  ["tracking", "Move your hand; the robot copies it."],
  ["limited", "Move your hand; the robot copies it."],
  ["unusual", "Move your hand; the robot copies it."],
  ["outside", "Your fingers are where the robot's cannot follow them exactly."],
  ["easing", "The robot catches up with your hand."],
  ["returning", "The robot comes back to your hand."],
  ["relaxing", "Your hand was away for a long time, so the robot hand opens. Show your hand again."],
  ["arm held", "The arm waits: your wrist moved too fast. Move it calmly."],
  ["arm", "The arm waits until your wrist moves calmly."],
  ["frozen", "The pictures do not change. Is the camera covered or stopped?"],
  ["held: the input has not", "Hold your hand still for a moment."],
  ["held: the person's hand is being measured", "Your hand is being measured. Hold it still for a moment."],
  ["held: the hand is another person's", "This is another person's hand. Release the controls and engage again."],
  ["held: a keypoint", "Your hand moved too fast, or was not seen well. Move it calmly, with the palm to the camera."],
  ["held: the glove's frames come late", SLOW],
  ["held: no newer", "No pictures arrive. Show your hand again."],
  ["held: the glove lost", "Your hand is not seen. Show it again."],
  ["disengaged", "Press Engage when you are ready."],
];

// States in which no hand arrives. Where the page makes the hand, only a slow computer can be the reason.
const UNSEEN = ["relaxing", "frozen", "held: no newer", "held: the glove lost"];

/** The server's state in words for a person; reasons for a refusal and what is unknown stand as they are. */
function plain(status = "", virtual = false) {
  const reason = status.split("; messages arrive but are refused: ")[1];
  if (reason) return sentence(reason);
  if (virtual && UNSEEN.some((words) => status.startsWith(words))) return SLOW;
  return PLAIN.find(([words]) => status.startsWith(words))?.[1] ?? sentence(status);
}

const sentence = (words) => (words ? `${words[0].toUpperCase()}${words.slice(1).replaceAll("`", "")}.` : "");

/** How well the hand is seen, from 0 to 1, and in words that agree with what the robot does. */
export function quality({ hand, state, device }) {
  if (["pointer", "recording", "simulated"].includes(device)) return { value: 1, words: "No camera needed" };
  if (!hand.seen) return { value: 0, words: hand.t === undefined ? "No hand yet" : "No hand seen" };
  const value = hand.score * Math.min(hand.rate / 25, 1);
  if (state?.slow) return { value: Math.min(value, 0.4), words: "Hand seen, but this computer is too slow" };
  if (state?.engaged && !state.following) return { value: Math.min(value, 0.7), words: "Hand seen; the robot waits" };
  const advice = value > 0.8 ? "" : hand.rate < 20 ? ", but only few pictures a second" : "; more light would help";
  return { value, words: `Hand seen${value > 0.8 ? " well" : advice}` };
}

const STEADY_MS = 300;

/** Shows a situation once it has lasted, so that people can read it; `again` is called when to look once more. */
export class Steady {
  constructor(again) {
    this.again = again;
  }

  /** Returns the situation to show in place of `now`. What the person did, engaging, shows at once. */
  step(now, engaged) {
    const time = performance.now();
    const words = now.headline + now.detail + now.words;
    if (words !== this.words) [this.words, this.since] = [words, time];
    if (!this.shown || engaged !== this.engaged || time - this.since >= STEADY_MS) {
      [this.shown, this.engaged] = [now, engaged];
    } else {
      clearTimeout(this.timeout);
      this.timeout = setTimeout(this.again, STEADY_MS - (time - this.since) + 1);
    }
    return this.shown;
  }
}
