"use strict";
// A4 less its margins, at CSS's 96 pixels an inch, and half of it: paper does not tell its width to scripts in time.
const PAPER_WIDTH_PX = { whole: 690, half: 335 };
const specs = JSON.parse(document.getElementById("specs").textContent);
// On a touch screen a finger that moves scrolls the page; on a desk the mouse zooms.
const dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
const config = { responsive: true, displayModeBar: false };
const drawn = Object.entries(specs).map(([id, spec]) => Plotly.newPlot(id, spec.data, { ...spec.layout, dragmode }, config));
Promise.all(drawn).then(() => document.documentElement.setAttribute("data-drawn", String(drawn.length)));
const paperWidth = (id) => (document.getElementById(id).closest(".alone") ? PAPER_WIDTH_PX.whole : PAPER_WIDTH_PX.half);
const resized = (widthOf) =>
  Object.keys(specs).forEach((id) => Plotly.relayout(id, { width: widthOf(id), autosize: widthOf(id) === null }));
addEventListener("beforeprint", () => resized(paperWidth));
addEventListener("afterprint", () => resized(() => null));
