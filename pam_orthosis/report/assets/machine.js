"use strict";
// draws a machine in side view into an SVG: its body, its actuators as thick as they are, coloured by pressure
const RAMP = ["#0d0887", "#7e03a8", "#cc4778", "#f89540", "#f0f921"], LEAST = 1, MOST = 7;  // bar, ends of the colours

function shade(bar) {
  const place = Math.min(Math.max((bar - LEAST) / (MOST - LEAST), 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(place), RAMP.length - 2), part = place - low;
  const channel = (colour, i) => parseInt(colour.slice(1 + 2 * i, 3 + 2 * i), 16);
  const mixed = [0, 1, 2].map(i => Math.round(channel(RAMP[low], i) * (1 - part) + channel(RAMP[low + 1], i) * part));
  return `rgb(${mixed})`;
}

class Drawing {
  constructor(svg, extent, names, corners) {
    const [[x0, z0], [x1, z1]] = extent, edge = 0.12 * Math.max(x1 - x0, z1 - z0);
    this.width = (x1 - x0 + 2 * edge) / 100;
    svg.setAttribute("viewBox", `${x0 - edge} ${-z1 - edge} ${x1 - x0 + 2 * edge} ${z1 - z0 + 2 * edge}`);
    const made = (tag, given) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
      for (const [key, value] of Object.entries(given)) element.setAttribute(key, value);
      return svg.appendChild(element);
    };
    const round = {fill: "none", "stroke-linecap": "round", "stroke-linejoin": "round"};
    this.actuators = Object.fromEntries(names.map(name => [name, {
      chain: made("polyline", {...round, stroke: "var(--faint)", "stroke-width": this.width / 2}),
      bar: made("polyline", {...round, "stroke-linecap": "butt"}),
      name: made("text", {fill: "var(--ink)", "font-size": 3.2 * this.width, "text-anchor": "middle",
                          "dominant-baseline": "central"}),
    }]));
    const small = {fill: "var(--faint)", "font-size": 2.6 * this.width, "text-anchor": "middle"};
    this.corners = corners.map(name => made("text", small));
    corners.forEach((name, i) => { this.corners[i].textContent = name; });
    this.body = made("polyline", {...round, stroke: "var(--ink)", "stroke-width": 1.4 * this.width});
  }

  // body: points; actuators: name -> {upper, lower, chain, diameter, bar}
  show(body, actuators) {
    const text = points => points.map(([x, z]) => `${x},${-z}`).join(" ");
    this.body.setAttribute("points", text(body));
    body.forEach(([x, z], i) => {
      this.corners[i].setAttribute("x", x);
      this.corners[i].setAttribute("y", -z + 13 * this.width);
    });
    for (const [name, one] of Object.entries(actuators)) {
      const drawn = this.actuators[name];
      drawn.chain.setAttribute("points", text([one.lower, one.chain]));
      drawn.bar.setAttribute("points", text([one.upper, one.lower]));
      drawn.bar.setAttribute("stroke-width", Math.max(one.diameter, this.width));
      drawn.bar.setAttribute("stroke", one.bar === null ? "var(--faint)" : shade(one.bar));
      drawn.name.setAttribute("transform", this.beside(one, body));
      drawn.name.textContent = one.bar === null ? name : `${name} ${one.bar.toFixed(1)} bar`;
    }
  }

  // where an actuator's name is: along it, on the side away from the body, never upside down
  beside(one, body) {
    const [ax, az] = [0, 1].map(i => one.lower[i] - one.upper[i]), length = Math.hypot(ax, az) || 1;
    const [x, z] = [0, 1].map(i => (one.lower[i] + one.upper[i]) / 2), far = one.diameter / 2 + 2.6 * this.width;
    const [ox, oz] = [x - (body[0][0] + body[1][0]) / 2, z - (body[0][1] + body[1][1]) / 2];
    const side = Math.sign(az * ox - ax * oz) || 1, turned = -Math.atan2(az, ax) * 180 / Math.PI;
    const upright = ((turned + 90) % 180 + 180) % 180 - 90;
    return `translate(${x + side * far * az / length} ${-z + side * far * ax / length}) rotate(${upright})`;
  }
}
