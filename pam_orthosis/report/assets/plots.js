"use strict";
// colours by what a curve means, after Okabe and Ito: told apart by those who confuse red and green
const COLOURS = {
  light: {ink: "#1b1b1b", faint: "#767676", pale: "#c4c8cc", grid: "#dddddd", blue: "#0072b2", orange: "#d55e00", green: "#007a5a",
          purple: "#b0578d", sky: "#2a8fc9", amber: "#b97f00"},
  dark: {ink: "#ececec", faint: "#a0a0a0", pale: "#5b626a", grid: "#3a3f45", blue: "#56b4e9", orange: "#ff9a62", green: "#2fc79b",
         purple: "#e59fc8", sky: "#8fd0ff", amber: "#f0c04a"},
};
// ticks with their whole numbers: 1, 2 and 5 of each decade
const TICKS = [...Array(15).keys()].flatMap(i => [1, 2, 5].map(digit => Number(`${digit}e${i - 7}`)));
const LOG = {type: "log", tickmode: "array", tickvals: TICKS, ticktext: TICKS.map(String)};
const dark = matchMedia("(prefers-color-scheme: dark)");
const plots = [...document.querySelectorAll("[data-plot]")];

function coloured(text) {
  const scheme = COLOURS[dark.matches ? "dark" : "light"];
  return JSON.parse(text.replace(/"@(\w+)"/g, (_, role) => JSON.stringify(scheme[role])));
}

function axis(title, scheme, more) {
  return {title: {text: title, standoff: 8}, gridcolor: scheme.grid, zerolinecolor: scheme.grid, automargin: true, ...more};
}

function layout(plot) {
  const scheme = COLOURS[dark.matches ? "dark" : "light"];
  return {
    height: plot.height, margin: {l: 50, r: 12, t: 8, b: 40}, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: {color: scheme.ink, family: "system-ui, sans-serif", size: 13}, hovermode: plot.shared ? "x" : "closest",
    barmode: "group", legend: {orientation: "h", x: 0, y: 1.02, yanchor: "bottom"}, dragmode: "zoom",
    showlegend: plot.data.length > 1 || plot.levels.length > 0,
    xaxis: axis(plot.x, scheme, {}), yaxis: axis(plot.y, scheme, plot.log ? LOG : {}),
    shapes: plot.levels.map(level => ({
      type: "line", xref: "paper", x0: 0, x1: 1, y0: level, y1: level, line: {color: scheme.ink, width: 1, dash: "dash"}})),
  };
}

function draw(place) {
  const plot = coloured(place.dataset.plot);
  return Plotly.react(place, plot.data, layout(plot), {responsive: true, displaylogo: false, displayModeBar: false});
}

// plots over the same time zoom together
let zooming = false;
async function follow(place, change) {
  const keys = ["xaxis.range[0]", "xaxis.range[1]", "xaxis.autorange"].filter(key => key in change);
  const shared = JSON.parse(place.dataset.plot).shared;
  if (zooming || !keys.length || !shared) return;
  zooming = true;
  const same = Object.fromEntries(keys.map(key => [key, change[key]]));
  const others = plots.filter(other => other !== place && JSON.parse(other.dataset.plot).shared === shared);
  await Promise.all(others.map(other => Plotly.relayout(other, same)));
  zooming = false;
}

Promise.all(plots.map(draw)).then(() => {
  for (const place of plots) place.on("plotly_relayout", change => follow(place, change));
  document.body.dataset.drawn = plots.length;
});
dark.addEventListener("change", () => plots.forEach(draw));
