// Draws one scene with WebGL and on the processor.

import * as THREE from "three";
import { mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";
import { ProcessorRenderer } from "../src/processor_renderer.js";

const [WIDTH, HEIGHT] = [320, 240];
const material = (options) => new THREE.MeshLambertMaterial(options);
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(50, WIDTH / HEIGHT, 0.05, 20);

const sun = new THREE.DirectionalLight("#fff6ea", 1.9);
sun.position.set(-0.7, 1.6, 0.9);
scene.add(new THREE.HemisphereLight("#fff", "#998", 1.2), sun);

const still = (mesh) => Object.assign(mesh, { userData: { still: true } });
// Reaches behind the camera.
const ground = still(new THREE.Mesh(new THREE.BoxGeometry(8, 0.1, 8, 40, 1, 40), material({ color: "#b6895c" })));
ground.position.y = -0.3;

const striped = new THREE.TorusKnotGeometry(0.22, 0.07, 160, 24);
const heights = striped.attributes.position;
const colours = Array.from({ length: heights.count }, (_, i) => [heights.getY(i) + 0.5, 0.5, 0.3]).flat();
striped.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
const knot = new THREE.Mesh(striped, material({ vertexColors: true }));

const ball = mergeVertices(new THREE.SphereGeometry(1, 48, 32));
const balls = new THREE.InstancedMesh(ball, material({ color: "#fff" }), 3);
["#e69f00", "#009e73", "#0072b2"].forEach((colour, i) => {
  const place = new THREE.Matrix4().makeScale(0.08, 0.1, 0.08).setPosition(0.3 * (i - 1), -0.1, 0.4);
  balls.setMatrixAt(i, place);
  balls.setColorAt(i, new THREE.Color(colour));
});
const glass = new THREE.Mesh(ball, material({ color: "#d33", transparent: true, opacity: 0.4 }));
glass.scale.setScalar(0.15);
scene.add(ground, knot, balls, glass);

const [webgl, processor] = [0, 1].map(() => document.createElement("canvas"));
const renderers = [new THREE.WebGLRenderer({ canvas: webgl, alpha: true, preserveDrawingBuffer: true }), new ProcessorRenderer(processor)];
for (const renderer of renderers) renderer.setSize(WIDTH, HEIGHT, false);

/**
 * Draws after moving the camera by an angle and the rest by a share.
 *
 * @returns {number[]} how many values WebGL's picture has, the mean difference of the pictures, and the share of
 *   values that differ by more than 8 of 255.
 */
window.draw = (angle, share) => {
  camera.position.set(1.1 * Math.sin(angle), 0.35, 1.1 * Math.cos(angle));
  camera.lookAt(0, -0.05, 0);
  knot.rotation.set(share, 2 * share, 0);
  balls.position.y = 0.1 * share;
  glass.position.set(0.3 - 0.6 * share, 0.05, 0.5);
  const picture = document.createElement("canvas");
  Object.assign(picture, { width: WIDTH, height: HEIGHT });
  const [wanted, drawn] = renderers.map((renderer, i) => {
    renderer.render(scene, camera);
    const context = picture.getContext("2d", { willReadFrequently: true });
    context.clearRect(0, 0, WIDTH, HEIGHT);
    context.drawImage([webgl, processor][i], 0, 0);
    return context.getImageData(0, 0, WIDTH, HEIGHT).data;
  });
  const differences = Array.from(wanted, (value, i) => Math.abs(value - drawn[i]));
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  return [new Set(wanted).size, mean(differences), mean(differences.map((difference) => Number(difference > 8)))];
};
window.ready = true;
