for (const box of document.querySelectorAll(".player")) {
  const data = JSON.parse(box.querySelector("script").textContent);
  const canvas = box.querySelector("canvas"), slider = box.querySelector("input");
  const button = box.querySelector("button"), clock = box.querySelector("output");
  const pen = canvas.getContext("2d");
  const images = data.frames.map((text) => Object.assign(new Image(), { src: "data:image/jpeg;base64," + text }));
  canvas.width = data.width; canvas.height = data.height; slider.max = images.length - 1;
  let playing = null;
  const line = (points, colour) => {
    pen.strokeStyle = colour; pen.lineWidth = 2; pen.beginPath();
    points.forEach(([u, v], i) => (i ? pen.lineTo(u, v) : pen.moveTo(u, v))); pen.stroke();
  };
  const draw = () => {
    const i = Number(slider.value), [[u0, v0], [u1, v1]] = data.target;
    pen.drawImage(images[i], 0, 0, data.width, data.height);
    line(data.before[i], "#D55E00"); line(data.after[i], "#4FA8E0");
    pen.strokeStyle = "#E58CC0"; pen.strokeRect(u0, v0, u1 - u0, v1 - v0);
    clock.textContent = data.t[i] + " ms";
  };
  const stop = () => { clearInterval(playing); playing = null; button.textContent = "Play"; };
  button.onclick = () => {
    if (playing) return stop();
    button.textContent = "Pause";
    playing = setInterval(() => { slider.value = (Number(slider.value) + 1) % images.length; draw(); }, 80);
  };
  slider.oninput = draw;
  Promise.all(images.map((image) => image.decode())).then(draw);
}
