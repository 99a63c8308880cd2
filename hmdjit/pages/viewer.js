"use strict";
// Two clips side by side, at the display's rate; each clip is one tall picture.
for (const viewer of document.querySelectorAll(".viewer")) {
  const known = JSON.parse(viewer.querySelector("script").textContent);
  const { rate, frames, width, height } = known;
  const zoom = Number(viewer.dataset.zoom);
  const said = viewer.querySelector("output");
  const play = viewer.querySelector('[data-do="play"]');
  const range = (axis) => viewer.querySelector(`[data-axis="${axis}"]`);
  const sides = [...viewer.querySelectorAll(".side")].map((side) => {
    const image = new Image();
    const select = side.querySelector("select");
    const whole = side.querySelector(".whole");
    const magnified = side.querySelector(".zoom");
    [whole.width, whole.height] = [width, height];
    [magnified.width, magnified.height] = [zoom, zoom];
    const load = () => { image.src = known.sprites[known.names[select.value]]; };
    select.addEventListener("change", load);
    image.addEventListener("load", () => draw());
    whole.addEventListener("click", (event) => {
      const box = whole.getBoundingClientRect();
      range("x").value = ((event.clientX - box.left) / box.width) * width - zoom / 2;
      range("y").value = ((event.clientY - box.top) / box.height) * height - zoom / 2;
      draw();
    });
    load();
    return { image, whole, magnified };
  });
  let frame = 0, begun = null, timer = null;

  // Forth and back: no jump at the end.
  const turned = (k) => {
    const period = 2 * frames - 2, place = ((k % period) + period) % period;
    return place < frames ? place : period - place;
  };

  function draw() {
    const top = turned(frame) * height;
    const x = Number(range("x").value), y = Number(range("y").value);
    for (const { image, whole, magnified } of sides) {
      if (!image.complete || !image.naturalWidth) continue;
      const paper = whole.getContext("2d");
      paper.drawImage(image, 0, top, width, height, 0, 0, width, height);
      paper.strokeStyle = "#fff";
      paper.strokeRect(x + 0.5, y + 0.5, zoom - 1, zoom - 1);
      const near = magnified.getContext("2d");
      near.drawImage(image, x, top + y, zoom, zoom, 0, 0, zoom, zoom);
    }
    viewer.dataset.frame = turned(frame);
  }

  function tick(now) {
    if (begun === null) begun = now - ((frame + 0.5) * 1000) / rate;
    const latest = Math.floor(((now - begun) * rate) / 1000);
    if (latest !== frame) {
      frame = latest;
      draw();
    }
    timer = requestAnimationFrame(tick);
  }

  function start() {
    begun = null;
    timer = requestAnimationFrame(tick);
    play.textContent = "Pause";
    said.textContent = `playing, ${Math.round(rate)} Hz`;
  }

  function stop() {
    if (timer !== null) cancelAnimationFrame(timer);
    timer = null;
    play.textContent = "Play";
    said.textContent = `frame ${turned(frame) + 1} of ${frames}`;
  }

  function step(by) {
    stop();
    frame += by;
    draw();
    said.textContent = `frame ${turned(frame) + 1} of ${frames}`;
  }

  const actions = {
    play: () => (timer === null ? start() : stop()),
    back: () => step(-1),
    step: () => step(1),
  };
  for (const button of viewer.querySelectorAll("[data-do]"))
    button.addEventListener("click", actions[button.dataset.do]);
  for (const axis of ["x", "y"]) range(axis).addEventListener("input", draw);

  const still = matchMedia("(prefers-reduced-motion: reduce)");
  still.addEventListener("change", () => still.matches && stop());
  if (still.matches) stop();
  else start();
}
