// The mouse, or a finger on a touch screen, in place of a hand: where it is over the view, and the grip that closes.

const RATE_HZ = 30;
const GRIPS = { 1: "index", 2: "middle", 3: "ring", 4: "little", 5: "hand" };

export class Pointer {
  /**
   * A mouse's button closes the chosen grip while it is held. A finger only moves the hand, as it cannot hover:
   * `toggle` closes and opens grips.
   *
   * @param {HTMLElement} area in which the pointer counts
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
    const move = ({ clientX, clientY, isPrimary }) => {
      if (!isPrimary) return;
      const { left, top, width, height } = this.area.getBoundingClientRect();
      this.hand.x = limit((2 * (clientX - left)) / width - 1);
      this.hand.y = limit((2 * (clientY - top)) / height - 1);
    };
    this.area.addEventListener("pointermove", move, { signal });
    this.area.addEventListener(
      "pointerdown",
      (event) => {
        if (event.pointerType === "touch") move(event);
        else this.hand.closed = true;
      },
      { signal },
    );
    window.addEventListener(
      "pointerup",
      ({ pointerType, target }) => {
        if (pointerType !== "touch" && !target.closest?.("[data-grip]")) this.hand.closed = false;
      },
      { signal },
    );
    this.area.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.reach(this.hand.z - event.deltaY / 1500);
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

  /** Closes a grip, or opens it if it is closed. */
  toggle(grip) {
    this.hand.closed = !(this.hand.closed && this.hand.grip === grip);
    this.hand.grip = grip;
  }

  /** Moves the hand forward to `z`, a share of its way. */
  reach(z) {
    this.hand.z = limit(z);
  }

  stop() {
    clearInterval(this.timer);
    this.listeners?.abort();
    this.hand.closed = false;
  }
}

const limit = (value) => Math.min(Math.max(value, -1), 1);
