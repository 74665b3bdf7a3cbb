// In place of the camera: a canvas that shows the pictures in turns.
(pictures) => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 640, height: 480 });
  const images = pictures.map((src) => Object.assign(new Image(), { src }));
  const context = canvas.getContext("2d");
  let number = 0;
  setInterval(() => context.drawImage(images[number++ % images.length], 0, 0, 640, 480), 40);
  navigator.mediaDevices.getUserMedia = async () => canvas.captureStream(25);
}
