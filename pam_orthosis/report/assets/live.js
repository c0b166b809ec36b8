"use strict";
// shows what the live view's node sends: {state, legs: {name: [{time, measured, ..., body, actuators}, ...]}}
const SECONDS = 10, REDRAWN_MS = 300;  // of the curves
const WORDS = {waiting: "waiting for the run", running: "running", stopped: "emergency stop", over: "the run is over"};
const element = id => document.getElementById(id);
const legs = Object.fromEntries([...document.querySelectorAll("[data-leg]")].map(section => {
  const svg = section.querySelector("svg"), {extent, names, corners} = JSON.parse(svg.dataset.live);
  const cells = Object.fromEntries([...section.querySelectorAll("[data-number]")].map(one => [one.dataset.number, one]));
  return [section.dataset.leg, {
    drawing: new Drawing(svg, extent, names, corners), names, cells, plots: section.querySelectorAll(".plot"), past: []}];
}));

function show(state) {
  element("state").textContent = WORDS[state];
  element("state").className = `answer ${{running: "good", stopped: "bad"}[state] || ""}`;
  document.body.dataset.state = state;
  for (const id of ["stop", "reset"]) element(id).disabled = state === "over";
}

function move(leg, fresh) {
  const now = fresh.at(-1), last = leg.past.at(-1);
  if (last && now.time < last.time) leg.past = [];  // another run
  leg.past = [...leg.past, ...fresh].filter(one => one.time > now.time - SECONDS);
  leg.drawing.show(now.body, now.actuators);
  for (const [name, cell] of Object.entries(leg.cells)) {
    cell.textContent = (Math.round(100 * now[name]) / 100 + 0).toFixed(2);  // no -0.00
  }
}

setInterval(() => {
  for (const {past, plots, names} of document.hidden ? [] : Object.values(legs)) {
    if (!past.length || !plots[0].layout || plots[0].shown === past.at(-1)) continue;
    plots[0].shown = past.at(-1);
    const time = past.map(one => one.time);
    Plotly.restyle(plots[0], {x: [time], y: [past.map(one => one.error)]});
    Plotly.restyle(plots[1], {x: names.map(() => time), y: names.map(name => past.map(one => one.actuators[name].bar))});
  }
}, REDRAWN_MS);

dark.addEventListener("change", () => Object.values(legs).forEach(({plots}) => { plots[0].shown = null; }));

const events = new EventSource("events");
events.onmessage = message => {
  const said = JSON.parse(message.data);
  show(said.state);
  for (const [name, fresh] of Object.entries(said.legs)) move(legs[name], fresh);
};
events.onerror = () => {
  if (document.body.dataset.state === "over") return events.close();
  element("state").textContent = "no connection to the live view";
  element("state").className = "answer bad";
};
for (const act of ["stop", "reset"]) element(act).addEventListener("click", async () => {
  element("said").textContent = "...";
  const answer = await fetch(act, {method: "POST"}).then(one => one.text(), () => "no connection: the live view is gone");
  element("said").textContent = answer;
});
show("waiting");
