// The best times of each hand, task and object, which stay in this browser.

const NUMBER = 3;
const name = (hand, { task, object }) => `best ${hand} ${task} ${object}`;

/** Returns the best times, s, fastest first. */
export function best(hand, state) {
  // Browsers that block cookies throw at any use of the storage; then no times are remembered.
  try {
    return JSON.parse(localStorage.getItem(name(hand, state)) ?? "[]");
  } catch {
    return [];
  }
}

/** Remembers the time of a successful state. */
export function remember(hand, state) {
  const times = [...best(hand, state), state.outcome.seconds].sort((a, b) => a - b).slice(0, NUMBER);
  try {
    localStorage.setItem(name(hand, state), JSON.stringify(times));
  } catch {}
}
