"use strict";
// plays a recorded machine; a line in the plots beside it shows the instant
for (const svg of document.querySelectorAll("[data-machine]")) {
  const data = JSON.parse(svg.dataset.machine), names = Object.keys(data.actuators);
  const drawing = new Drawing(svg, data.extent, names, data.corners), controls = svg.nextElementSibling;
  const [button, slider, output] = ["button", "input", "output"].map(tag => controls.querySelector(tag));
  let playing = 0;

  function show() {
    const i = Number(slider.value), time = data.time[i];
    drawing.show(data.body[i], Object.fromEntries(names.map(name => {
      const one = data.actuators[name];
      return [name, {upper: one.upper[i], lower: one.lower[i], chain: one.chain[i], diameter: one.diameter[i],
                     bar: one.bar ? one.bar[i] : null}];
    })));
    output.textContent = `${time.toFixed(2)} s`;
    const line = {type: "line", yref: "paper", y0: 0, y1: 1, x0: time, x1: time, line: {color: "#b0578d", width: 1.5}};
    for (const place of typeof plots === "undefined" ? [] : plots) {
      if (!place.layout || !JSON.parse(place.dataset.plot).shared) continue;
      const others = (place.layout.shapes || []).filter(one => one.yref !== "paper");
      Plotly.relayout(place, {shapes: [...others, line]});
    }
  }
  function play(on) {
    clearInterval(playing);
    playing = on ? setInterval(() => {
      slider.value = (Number(slider.value) + 1) % data.time.length;
      show();
    }, 1000 * (data.time[1] - data.time[0])) : 0;
    button.textContent = on ? "pause" : "play";
  }
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => { play(false); show(); });
  show();
}
