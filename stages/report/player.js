"use strict";
// Plays the frames of each .player, with the strings drawn over them as its boxes are ticked.
for (const box of document.querySelectorAll(".player")) {
  const data = JSON.parse(box.querySelector("script").textContent);
  const find = (name) => box.querySelector(name);
  const canvas = find("canvas"), slider = find("input[type=range]"), button = find("button");
  const speed = find("select"), clock = find("output"), pen = canvas.getContext("2d");
  const layers = [...box.querySelectorAll("input[type=checkbox]")];
  const images = data.frames.map((source) => Object.assign(new Image(), { src: source }));
  canvas.width = data.width;
  canvas.height = data.height;
  slider.max = images.length - 1;
  slider.value = data.start;

  const trace = (points, colour, closed) => {
    pen.strokeStyle = colour;
    pen.lineWidth = 2;
    pen.lineJoin = "round";
    pen.beginPath();
    points.forEach(([u, v]) => pen.lineTo(u, v));
    if (closed) pen.closePath();
    pen.stroke();
  };
  const draw = () => {
    const i = Number(slider.value);
    if (images[i].complete) pen.drawImage(images[i], 0, 0, data.width, data.height);
    data.obstacles.forEach((corners) => trace(corners, "#9fabbd", true));
    trace(data.target, "#e79cc6", true);
    for (const layer of layers) if (layer.checked) trace(data.strings[layer.value][i], layer.dataset.colour, false);
    clock.textContent = Math.round(data.t[i]) + " ms";
    slider.setAttribute("aria-valuetext", clock.textContent);
  };

  let playing = null;
  const stop = () => {
    clearTimeout(playing);
    playing = null;
    button.textContent = "Play";
  };
  const step = () => {
    const i = Number(slider.value), next = (i + 1) % images.length;
    const wait = next ? (data.t[next] - data.t[i]) * Number(speed.value) : 800;
    playing = setTimeout(() => {
      slider.value = next;
      draw();
      step();
    }, wait);
  };
  button.onclick = () => {
    if (playing !== null) return stop();
    button.textContent = "Pause";
    if (Number(slider.value) === images.length - 1) slider.value = 0;
    step();
  };
  slider.oninput = () => {
    stop();
    draw();
  };
  layers.forEach((layer) => (layer.onchange = draw));
  images.forEach((image, i) => (image.onload = () => i === Number(slider.value) && draw()));
  draw();
}
