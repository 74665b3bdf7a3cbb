// The attempt of a session as the page saw it: replayed in the view, and as a film to keep.

const LONGEST_S = 180;
const STANDING = 15; // pictures of the end
const PICTURE_MS = 33;
const GROUND = "#e6ebef"; // behind the robot, as on the page

export class Replay {
  /**
   * @param {import("./view.js").View} view
   * @param {() => void} onChange called when a replay begins and ends
   */
  constructor(view, onChange) {
    this.view = view;
    this.onChange = onChange;
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
      this.onChange();
    });
  }

  stop() {
    if (!this.running) return;
    clearInterval(this.timer);
    this.timer = undefined;
    this.resolve();
    this.onChange();
  }

  /** Returns a film of the attempt, or null where the browser cannot record one. */
  async film() {
    const type = ["video/mp4", "video/webm"].find((name) => globalThis.MediaRecorder?.isTypeSupported(name));
    if (!type) return null;
    const { canvas } = this.view;
    // Encoders want even sizes, and films have no transparent ground.
    const picture = Object.assign(document.createElement("canvas"), {
      width: canvas.width & ~1,
      height: canvas.height & ~1,
    });
    const context = picture.getContext("2d", { alpha: false });
    // A stream that chooses its pictures by itself gets none where drawing is slow.
    const stream = picture.captureStream(0);
    const [track] = stream.getVideoTracks();
    this.view.onDraw = () => {
      context.fillStyle = GROUND;
      context.fillRect(0, 0, picture.width, picture.height);
      context.drawImage(canvas, 0, 0, picture.width, picture.height);
      track.requestFrame();
    };
    const recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: 6e6 });
    const parts = [];
    recorder.ondataavailable = ({ data }) => parts.push(data);
    const ended = new Promise((resolve) => (recorder.onstop = resolve));
    recorder.start();
    await this.play();
    // An encoder keeps its last pictures until others follow; a slow computer has drawn hardly any.
    for (let i = 0; i < STANDING; i += 1) {
      context.drawImage(picture, 0, 0);
      track.requestFrame();
      await new Promise((resolve) => setTimeout(resolve, PICTURE_MS));
    }
    recorder.stop();
    await ended;
    this.view.onDraw = undefined;
    if (parts.every(({ size }) => size === 0)) return null;
    return new File(parts, `geort-drake.${type.split("/")[1]}`, { type });
  }
}
