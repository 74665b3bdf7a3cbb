// The attempt of a session as the page saw it: replayed in the view, and as a film to keep.

const LONGEST_S = 180;

export class Replay {
  /** @param {import("./view.js").View} view */
  constructor(view) {
    this.view = view;
    this.clear();
  }

  /** Forgets the attempt, as when another begins. */
  clear() {
    this.stop();
    this.frames = [];
  }

  get running() {
    return this.timer !== undefined;
  }

  /** Adds a binary message's poses; `time` is the first of its values, s. */
  add(values) {
    if (this.running) return;
    this.frames.push(values);
    while (this.frames.at(-1)[0] - this.frames[0][0] > LONGEST_S) this.frames.shift();
  }

  /** Shows the attempt in real time; resolves at its end. */
  play() {
    this.stop();
    const began = performance.now();
    const { frames } = this;
    let next = 0;
    return new Promise((resolve) => {
      this.resolve = resolve;
      this.timer = setInterval(() => {
        const time = (performance.now() - began) / 1000 + frames[0]?.[0];
        while (next < frames.length && frames[next][0] <= time) next += 1;
        if (next > 0) this.view.setPoses(frames[next - 1]);
        if (next >= frames.length) this.stop();
      }, 15);
    });
  }

  stop() {
    clearInterval(this.timer);
    this.timer = undefined;
    this.resolve?.();
  }

  /** Returns a film of the attempt, or null where the browser cannot record one. */
  async film() {
    const type = ["video/mp4", "video/webm"].find((name) => globalThis.MediaRecorder?.isTypeSupported(name));
    if (!type) return null;
    const stream = this.view.canvas.captureStream(30);
    const recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: 6e6 });
    const parts = [];
    recorder.ondataavailable = ({ data }) => parts.push(data);
    const ended = new Promise((resolve) => (recorder.onstop = resolve));
    recorder.start();
    await this.play();
    recorder.stop();
    await ended;
    return new File(parts, `geort-drake.${type.split("/")[1]}`, { type });
  }
}
