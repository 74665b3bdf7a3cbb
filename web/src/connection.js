// The WebSocket to `geort-drake live`; connects again by itself.

const RETRY_MS = 1000;

export class Connection {
  /**
   * @param {{onClose: (refusal: string) => void, onMessage: (message: object) => void,
   *   onPoses: (values: Float32Array) => void}} listeners
   */
  constructor(listeners) {
    this.listeners = listeners;
    this.#connect();
  }

  get open() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.open) this.socket.send(JSON.stringify(message));
  }

  /** Sends a hand, unless older ones still wait: a slow network must not delay the robot. */
  sendHand(message) {
    if (this.socket.bufferedAmount < 16384) this.send(message);
  }

  #connect() {
    const url = new URL("ws", location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    url.search = `?key=${encodeURIComponent(location.hash.slice(1))}`;
    const socket = (this.socket = new WebSocket(url));
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.listeners.onMessage(JSON.parse(data));
      else this.listeners.onPoses(new Float32Array(data));
    };
    let opened = false;
    socket.onopen = () => (opened = true);
    socket.onclose = async ({ reason }) => {
      this.listeners.onClose(opened ? reason : await whyRefused(url));
      setTimeout(() => this.#connect(), RETRY_MS);
    };
  }
}

/** Returns the server's reason for refusing a connection, which a WebSocket hides; "" if no server answers. */
async function whyRefused(url) {
  try {
    const response = await fetch(url.href.replace(/^ws/, "http"));
    return [403, 503].includes(response.status) ? await response.text() : "";
  } catch {
    return "";
  }
}
