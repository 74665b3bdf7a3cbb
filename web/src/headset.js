// A headset: WebXR's hand joints go to the server, and the scene is shown in it.

const MODES = ["immersive-ar", "immersive-vr"];

/** Returns the first mode that the browser supports, or null. */
export async function headsetMode() {
  for (const mode of MODES) if (await navigator.xr?.isSessionSupported(mode).catch(() => false)) return mode;
  return null;
}

export class Headset {
  /**
   * @param {import("./view.js").View} view shows the scene in the headset.
   * @param {(result: {t: number, side: string, joints: number[][] | null}) => void} onResult `joints` are
   *   25 × [x, y, z], m, in the order of XRHand and in a local-floor space; null while no hand is tracked.
   * @param {() => void} onEnd
   */
  constructor(view, onResult, onEnd) {
    this.view = view;
    this.onResult = onResult;
    this.onEnd = onEnd;
  }

  /** @param {() => "right" | "left" | undefined} side of the hand that is sent; unknown without a connection. */
  async start(mode, side) {
    this.session = await navigator.xr.requestSession(mode, {
      requiredFeatures: ["local-floor", "hand-tracking"],
    });
    this.session.addEventListener("end", () => {
      this.view.leaveHeadset();
      this.onEnd();
    });
    await this.view.enterHeadset(this.session, (time, frame, space) => {
      const hand = readHand(this.session, frame, space, side());
      this.view.setOwnJoints(hand.joints);
      this.onResult({ t: time / 1000, ...hand });
    });
  }

  stop() {
    return this.session?.end();
  }
}

/** Reads the hand of `side`, or the other one if it is alone. */
function readHand(session, frame, space, side) {
  const hands = [...session.inputSources].filter(({ hand }) => hand);
  const source = hands.find(({ handedness }) => handedness === side) ?? hands[0];
  if (!source) return { side, joints: null };
  const positions = Array.from(source.hand.values(), (joint) => frame.getJointPose(joint, space)?.transform.position);
  const joints = positions.every(Boolean) ? positions.map(({ x, y, z }) => [x, y, z]) : null;
  return { side: source.handedness, joints };
}
