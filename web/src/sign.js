// A sign with two lines of words, for headsets.

import * as THREE from "three";

export class Sign extends THREE.Mesh {
  constructor() {
    const canvas = document.createElement("canvas");
    canvas.width = 1024;
    canvas.height = 256;
    const texture = new THREE.CanvasTexture(canvas);
    texture.colorSpace = THREE.SRGBColorSpace;
    super(
      new THREE.PlaneGeometry(0.8, 0.2),
      new THREE.MeshBasicMaterial({ map: texture, transparent: true, toneMapped: false }),
    );
    this.context = canvas.getContext("2d");
    this.texture = texture;
  }

  write(headline, detail) {
    if (this.words === headline + detail) return;
    this.words = headline + detail;
    const { context } = this;
    context.clearRect(0, 0, 1024, 256);
    context.fillStyle = "rgb(16 20 24 / 80%)";
    context.beginPath();
    context.roundRect(0, 0, 1024, 256, 48);
    context.fill();
    context.textAlign = "center";
    context.fillStyle = "#fff";
    context.font = "600 68px system-ui, sans-serif";
    context.fillText(headline, 512, 118, 960);
    context.font = "44px system-ui, sans-serif";
    context.fillStyle = "#c6ced4";
    context.fillText(detail, 512, 196, 960);
    this.texture.needsUpdate = true;
  }
}
