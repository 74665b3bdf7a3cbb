// The 21 keypoints of a hand, in MediaPipe's order, and their drawing over a picture.

export const FINGERS = [
  { name: "thumb", colour: "#e69f00" },
  { name: "index", colour: "#56b4e9" },
  { name: "middle", colour: "#009e73" },
  { name: "ring", colour: "#cc79a7" },
  { name: "little", colour: "#0072b2" },
];

/** Bones as {parent, child, colour}, finger by finger from the wrist to the tip. */
export const BONES = FINGERS.flatMap(({ colour }, finger) =>
  [1, 2, 3, 4].map((i) => ({ parent: i === 1 ? 0 : 4 * finger + i - 1, child: 4 * finger + i, colour })),
);

/** Keypoint → place in the order of XRHand, which has a metacarpal's base for each finger as well. */
export const KEYPOINT_TO_XR = [0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24];

/** Draws a hand, 21 × [u, v] from 0 to 1, into a 2D context. */
export function drawSkeleton(context, image) {
  const { width, height } = context.canvas;
  const at = ([u, v]) => [u * width, v * height];
  context.lineCap = "round";
  context.lineWidth = width / 105;
  for (const { parent, child, colour } of BONES) {
    context.strokeStyle = colour;
    context.beginPath();
    context.moveTo(...at(image[parent]));
    context.lineTo(...at(image[child]));
    context.stroke();
  }
  context.fillStyle = "#fff";
  for (const point of image) {
    context.beginPath();
    context.arc(...at(point), width / 130, 0, 2 * Math.PI);
    context.fill();
  }
}
