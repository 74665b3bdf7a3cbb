// What the page says, from what it knows.

/**
 * @typedef {object} Model
 * @property {boolean} connected
 * @property {object | null} welcome the server's last message of this type
 * @property {object | null} state the server's last message of this type
 * @property {"camera" | "headset" | null} device
 * @property {string} failure why the device cannot be used, or ""
 * @property {string} refusal of the last message, or ""
 * @property {number | null} leaving number of the scene that a reset ends, until the next one is there
 * @property {{seen: boolean, side: string, score: number, rate: number, delay: number}} hand as the device sees it
 */

/**
 * @param {Model} model
 * @returns {{name: "connecting" | "waiting" | "tracking" | "engaged" | "lost", headline: string, detail: string}}
 */
export function situation({ connected, welcome, state, device, hand, refusal, leaving }) {
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
  if (leaving !== null) return say("waiting", "The scene starts again", "The robot holds until it is there.");
  const wrong = hand.seen && hand.side !== side;
  const seen = hand.seen && !wrong;
  if (state?.engaged && !seen)
    return say("lost", "Hand lost", `The robot holds until it sees your ${side} hand again.`);
  if (state?.outcome?.over)
    return state.outcome.success
      ? say(state.engaged ? "engaged" : "tracking", "Done", "Reset for another try.")
      : say(state.engaged ? "engaged" : "tracking", "Not this time", "Reset to try again.");
  if (state?.engaged && state.fist > 0)
    return say("engaged", "Keep the fist to stop", "The robot holds when the ring is full.");
  if (state?.engaged)
    return state.following
      ? say("engaged", "The robot follows your hand", refusal || sentence(state.status, device))
      : say("engaged", "The robot holds", refusal || sentence(state.status, device));
  if (!device) return say("waiting", `Hold up your ${side} hand`, "Start the camera or the headset first.");
  if (wrong)
    return say("waiting", `That is your ${hand.side} hand`, `This robot has a ${side} one. Show your ${side} hand.`);
  if (!seen) return say("waiting", `Hold up your ${side} hand`, "The whole hand, with the palm to the camera.");
  if (refusal) return say("tracking", "Not yet", refusal);
  if (welcome.robot === "real") return say("tracking", "Press Engage to take control", "The real robot will move.");
  return state?.fist > 0
    ? say("tracking", "Keep the fist", "The robot follows when the ring is full.")
    : say("tracking", "Hold a fist to take control", "Or press Engage. The robot moves as your hand does.");
}

const say = (name, headline, detail) => ({ name, headline, detail });

/** The state as a sentence; what the server calls a glove is the device. */
function sentence(status, device) {
  const words = status?.replaceAll("`", "").replaceAll("the glove", `the ${device ?? "page"}`);
  return words ? `${words[0].toUpperCase()}${words.slice(1)}.` : "";
}

/** Quality of tracking from 0 to 1, and in words. */
export function quality({ seen, score, rate }) {
  if (!seen) return { value: 0, words: "No hand" };
  const value = score * Math.min(rate / 25, 1);
  const grade = value > 0.8 ? "good" : value > 0.5 ? "fair" : "poor";
  const advice = value > 0.8 ? "" : rate < 20 ? ": slow pictures" : ": more light helps";
  return { value, words: `Tracking ${grade}${advice}` };
}
