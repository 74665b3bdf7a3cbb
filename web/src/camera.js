// The camera: its pictures go to the tracker, whose hands come back.

export class Camera {
  /**
   * @param {HTMLElement} mirror shows the pictures and the hand in them.
   * @param {(result: {t: number, hand: object | null, aspect: number, delay: number}) => void} onResult `t` is when
   *   the picture was taken and `delay` how long ago that is, s.
   * @param {(text: string) => void} onFailure
   */
  constructor(mirror, onResult, onFailure) {
    this.mirror = mirror;
    this.onResult = onResult;
    this.onFailure = onFailure;
    // The page never shows this element: without a GPU, showing a video takes longer than tracking the hand in it.
    this.video = Object.assign(document.createElement("video"), { muted: true, playsInline: true });
  }

  async start() {
    if (!navigator.mediaDevices) throw new Error("browsers allow it only on https pages and on this machine");
    const use = (this.use = {});
    const stream = await navigator.mediaDevices.getUserMedia({
      video: { width: { ideal: 640 }, height: { ideal: 480 }, frameRate: { ideal: 30 }, facingMode: "user" },
    });
    // The person may have stopped the camera before the browser granted it.
    if (this.use !== use) return stopTracks(stream);
    this.stream = stream;
    // For example, somebody unplugged it or withdrew the permission.
    this.stream.getVideoTracks()[0].onended = () => this.onFailure("The camera has stopped.");
    this.busy = true;
    this.worker = new Worker("worker.js");
    this.worker.onmessage = ({ data }) => this.#receive(data);
    this.worker.onerror = (event) => this.onFailure(`The hand tracker did not start: ${event.message}.`);
    const canvas = Object.assign(document.createElement("canvas"), { ariaLabel: "Mirrored picture of your hand" });
    this.mirror.replaceChildren(canvas);
    const width = Math.round(canvas.clientWidth * devicePixelRatio);
    const offscreen = canvas.transferControlToOffscreen();
    this.worker.postMessage({ canvas: offscreen, width }, [offscreen]);
    this.video.srcObject = this.stream;
    await this.video.play().catch((error) => {
      if (this.use === use) throw error;
    });
    if (this.use === use) this.#watch();
  }

  stop() {
    this.worker?.terminate();
    this.#keep(undefined);
    if (this.stream) stopTracks(this.stream);
    this.video.srcObject = null;
    this.use = this.worker = this.stream = undefined;
  }

  #watch() {
    this.video.requestVideoFrameCallback(async (now, picture) => {
      if (!this.worker) return;
      this.#watch();
      const t = (picture.captureTime ?? now) / 1000;
      // Firefox on phones has no VideoFrame; createImageBitmap takes longer.
      this.#keep({ frame: self.VideoFrame ? new VideoFrame(this.video) : await createImageBitmap(this.video), t });
      this.#give();
    });
  }

  /** Keeps a picture for the tracker, in place of an older one. */
  #keep(picture) {
    this.newest?.frame.close();
    this.newest = picture;
  }

  #give() {
    if (this.busy || !this.newest || !this.worker) return;
    this.busy = true;
    this.worker.postMessage(this.newest, [this.newest.frame]);
    this.newest = undefined;
  }

  #receive(data) {
    if (data.failure) {
      this.onFailure(`The hand tracker failed: ${data.failure}`);
      return;
    }
    this.busy = false;
    this.#give();
    if (data.ready) return;
    this.onResult({ ...data, delay: performance.now() / 1000 - data.t });
  }
}

const stopTracks = (stream) => stream.getTracks().forEach((track) => track.stop());
