// The mouse in place of a hand: where it is over the view, and which grip it closes.

const RATE_HZ = 30;
const GRIPS = { 1: "index", 2: "middle", 3: "ring", 4: "little", 5: "hand" };

export class Pointer {
  /**
   * @param {HTMLElement} area in which the mouse counts
   * @param {(hand: {t: number, x: number, y: number, z: number, grip: string, closed: boolean}) => void} onHand
   */
  constructor(area, onHand) {
    this.area = area;
    this.onHand = onHand;
    this.hand = { x: 0, y: 0, z: 0, grip: "hand", closed: false };
  }

  start() {
    this.listeners = new AbortController();
    const { signal } = this.listeners;
    const limit = (value) => Math.min(Math.max(value, -1), 1);
    this.area.addEventListener(
      "pointermove",
      ({ clientX, clientY }) => {
        const { left, top, width, height } = this.area.getBoundingClientRect();
        this.hand.x = limit((2 * (clientX - left)) / width - 1);
        this.hand.y = limit((2 * (clientY - top)) / height - 1);
      },
      { signal },
    );
    this.area.addEventListener("pointerdown", () => (this.hand.closed = true), { signal });
    window.addEventListener("pointerup", () => (this.hand.closed = false), { signal });
    this.area.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.hand.z = limit(this.hand.z - event.deltaY / 1500);
      },
      { signal, passive: false },
    );
    window.addEventListener(
      "keydown",
      ({ key, target }) => {
        if (!target.matches("input, select")) this.hand.grip = GRIPS[key] ?? this.hand.grip;
      },
      { signal },
    );
    this.timer = setInterval(() => this.onHand({ t: performance.now() / 1000, ...this.hand }), 1000 / RATE_HZ);
  }

  stop() {
    clearInterval(this.timer);
    this.listeners?.abort();
    this.hand.closed = false;
  }
}
