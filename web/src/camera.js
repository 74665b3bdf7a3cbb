// The camera: its pictures go to the tracker, whose hands come back.

import { startTracker } from "./tracker.js";

/** In place of a worker where workers have no WebGL, as in WebKitGTK: the tracker on the page's main thread. */
class PageWorker {
  constructor() {
    this.take = startTracker((data) => this.onmessage?.({ data }), loadScript);
  }

  postMessage(message) {
    this.take(message);
  }

  terminate() {
    this.onmessage = undefined;
  }
}

function loadScript(src) {
  return new Promise((onload, onerror) =>
    document.head.append(Object.assign(document.createElement("script"), { src, onload, onerror })),
  );
}

export class Camera {
  /**
   * @param {HTMLElement} mirror shows the pictures and the hand in them.
   * @param {boolean} software whether WebGL draws without a GPU.
   * @param {(result: {t: number, hand: object | null, aspect: number, delay: number}) => void} onResult `t` is when
   *   the picture was taken and `delay` how long ago that is, s.
   * @param {(text: string) => void} onFailure
   */
  constructor(mirror, software, onResult, onFailure) {
    this.mirror = mirror;
    this.software = software;
    this.onResult = onResult;
    this.onFailure = onFailure;
    // Not in the page: without a GPU, the browser takes longer to show a video than to track the hand in it.
    this.video = Object.assign(document.createElement("video"), { muted: true, playsInline: true });
  }

  async start() {
    if (!navigator.mediaDevices) throw new Error("the browser gives it to https and this machine only");
    this.stream = await navigator.mediaDevices.getUserMedia({
      video: { width: { ideal: 640 }, height: { ideal: 480 }, frameRate: { ideal: 30 }, facingMode: "user" },
    });
    this.busy = true;
    const alone = new OffscreenCanvas(1, 1).getContext("webgl2") !== null;
    this.worker = alone ? new Worker("worker.js") : new PageWorker();
    this.worker.onmessage = ({ data }) => this.#receive(data);
    this.worker.onerror = (event) => this.onFailure(`The hand tracker did not start: ${event.message}.`);
    const canvas = Object.assign(document.createElement("canvas"), { ariaLabel: "Mirrored picture of your hand" });
    this.mirror.replaceChildren(canvas);
    const offscreen = canvas.transferControlToOffscreen();
    this.worker.postMessage({ canvas: offscreen, software: this.software }, [offscreen]);
    this.video.srcObject = this.stream;
    await this.video.play();
    this.#watch();
  }

  stop() {
    this.worker?.terminate();
    this.stream?.getTracks().forEach((track) => track.stop());
    this.video.srcObject = null;
    this.worker = this.stream = undefined;
  }

  #watch() {
    this.video.requestVideoFrameCallback(async (now, picture) => {
      if (!this.worker) return;
      this.#watch();
      if (this.busy) return;
      this.busy = true;
      const t = (picture.captureTime ?? now) / 1000;
      // Firefox on phones has no VideoFrame; the other takes longer.
      const frame = self.VideoFrame ? new VideoFrame(this.video) : await createImageBitmap(this.video);
      this.worker?.postMessage({ frame, t }, [frame]);
    });
  }

  #receive(data) {
    if (data.failure) {
      this.onFailure(`The hand tracker failed: ${data.failure}`);
      return;
    }
    this.busy = false;
    if (data.ready) return;
    this.onResult({ ...data, delay: performance.now() / 1000 - data.t });
  }
}
