"use strict";
for (const button of document.querySelectorAll("button.copy")) {
  const code = button.parentElement.querySelector("code");
  const say = (text) => { button.textContent = text; setTimeout(() => { button.textContent = "Copy"; }, 1500); };
  const select = () => {
    const range = document.createRange();
    range.selectNodeContents(code);
    getSelection().removeAllRanges();
    getSelection().addRange(range);
    say(document.execCommand("copy") ? "Copied" : "Selected");
  };
  button.addEventListener("click", () => {
    // A page opened as a file may have no clipboard.
    if (navigator.clipboard) navigator.clipboard.writeText(code.textContent).then(() => say("Copied"), select);
    else select();
  });
}
addEventListener("beforeprint", () => {
  for (const folded of document.querySelectorAll("details")) folded.open = true;
});
const held = document.getElementById("motion");
if (held) {
  const motion = JSON.parse(held.textContent), last = motion.t.length - 1, edge = 24;
  const canvas = document.querySelector(".motion canvas"), pen = canvas.getContext("2d");
  const button = document.querySelector(".motion button"), slider = document.querySelector(".motion input");
  const clock = document.querySelector(".motion .play .key");
  let frame = motion.start, playing = false, began = 0;
  slider.max = last;
  const draw = () => {
    const width = canvas.clientWidth, sharp = devicePixelRatio || 1;
    const [wide, high] = motion.size.map((x) => Math.max(x, 1));
    const height = Math.round(Math.min(Math.max(width * high / wide, 160), 0.75 * width, 440));
    const scale = Math.min((width - 2 * edge) / wide, (height - 2 * edge) / high);
    const left = (width - scale * wide) / 2, foot = height - (height - scale * high) / 2;
    canvas.width = width * sharp;
    canvas.height = height * sharp;
    pen.scale(sharp, sharp);
    pen.lineWidth = 3;
    pen.lineCap = pen.lineJoin = "round";
    motion.lines.forEach((line) => {
      const points = line.points[frame], at = [];
      for (let i = 0; i < points.length; i += 2) at.push([left + scale * points[i], foot - scale * points[i + 1]]);
      pen.strokeStyle = pen.fillStyle = line.colour;
      pen.beginPath();
      at.forEach(([x, y]) => pen.lineTo(x, y));
      pen.stroke();
      pen.beginPath();
      pen.arc(...at[at.length - 1], 5, 0, 2 * Math.PI);
      pen.fill();
    });
    slider.value = frame;
    clock.textContent = `${motion.t[frame].toFixed(2)} s`;
    canvas.dataset.frame = frame;
  };
  const stop = () => { playing = false; button.textContent = "Play"; };
  const step = (now) => {
    if (!playing) return;
    const at = (now - began) / 1000;
    while (frame < last && motion.t[frame + 1] <= at) frame += 1;
    draw();
    if (frame === last) stop(); else requestAnimationFrame(step);
  };
  const play = () => {
    if (frame === last) frame = 0;
    playing = true;
    button.textContent = "Pause";
    began = performance.now() - 1000 * motion.t[frame];
    requestAnimationFrame(step);
  };
  button.addEventListener("click", () => (playing ? stop() : play()));
  slider.addEventListener("input", () => { stop(); frame = Number(slider.value); draw(); });
  addEventListener("resize", draw);
  draw();
}
