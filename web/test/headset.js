// A headset, emulated by IWER, that sees the hands given to `play`: side → 25 joints.
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
const request = navigator.xr.requestSession.bind(navigator.xr);
navigator.xr.requestSession = async (...options) => (window.session = await request(...options));
window.play = async (hands) => {
  const space = await session.requestReferenceSpace("local-floor");
  const names = Array.from(device.hands.left.inputSource.hand.keys());
  const still = [0, 0, 0, 0, 0, 0, 1];
  const schema = Object.keys(hands).map((handedness, i) => [i, {
    handedness, targetRayMode: "tracked-pointer", profiles: ["generic-hand"], hasGamepad: false,
    hasGrip: false, hasHand: true, jointSequence: names,
  }]);
  const inputs = Object.values(hands).map((points, i) =>
    [i, ...still, points.flatMap((point) => [...point, 0, 0, 0, 1, 0.01])]);
  const frames = [0, 1e6].map((time) => [time, 0, 1.6, 0, 0, 0, 0, 1, ...inputs]);
  device.createActionPlayer(space, { schema, frames }).play();
};
