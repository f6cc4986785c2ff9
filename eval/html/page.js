"use strict";
// A4 less its margins, at CSS's 96 pixels an inch, and half of it: paper does not tell its width to scripts in time.
const PAPER_WIDTH_PX = { whole: 690, half: 335 };
const TRUTH = "#111827";
const read = (id) => JSON.parse(document.getElementById(id).textContent);
const specs = read("specs");
const pictures = read("pictures");
const timed = [...document.querySelectorAll(".timed")];
const darkScheme = matchMedia("(prefers-color-scheme: dark)");
// On a touch screen a finger that moves scrolls the page; on a desk the mouse zooms.
const dragmode = matchMedia("(pointer: coarse)").matches ? false : "zoom";
const config = { responsive: true, displayModeBar: false };

const themed = (spec, dark) => {
  const look = { gridcolor: dark ? "#374151" : "#e5e7eb", zerolinecolor: dark ? "#6b7280" : "#9ca3af" };
  const layout = { ...spec.layout, dragmode, font: { ...spec.layout.font, color: dark ? "#e5e7eb" : "#1f2937" } };
  layout.hoverlabel = { bgcolor: dark ? "#1f2937" : "#ffffff" };
  for (const axis of ["xaxis", "yaxis"]) layout[axis] = { ...layout[axis], ...look };
  const shown = (trace) => (dark && trace.line?.color === TRUTH ? { ...trace, line: { ...trace.line, color: "#f3f4f6" } } : trace);
  return [spec.data.map(shown), layout];
};
const draw = (id, dark, width) => {
  const [data, layout] = themed(specs[id], dark);
  return Plotly.react(id, data, { ...layout, width, autosize: !width }, config);
};
const drawAll = (dark, widthOf = () => undefined) => Object.keys(specs).forEach((id) => draw(id, dark, widthOf(id)));

// Charts are drawn one by one, so that a page with long runs shows its verdict at once.
const start = async () => {
  for (const id of Object.keys(specs)) {
    await draw(id, darkScheme.matches);
    await new Promise((resolve) => setTimeout(resolve));
  }
  timed.forEach(link);
  document.documentElement.setAttribute("data-drawn", String(Object.keys(specs).length));
};
start();
darkScheme.addEventListener("change", () => drawAll(darkScheme.matches));
const paperWidth = (id) => (document.getElementById(id).closest(".alone") ? PAPER_WIDTH_PX.whole : PAPER_WIDTH_PX.half);
addEventListener("beforeprint", () => drawAll(false, paperWidth));
addEventListener("afterprint", () => drawAll(darkScheme.matches));

const viewer = document.getElementById("viewer");
viewer.querySelector("button").onclick = () => (viewer.hidden = true);
const moveCursor = (chart, at) => {
  const { xaxis, yaxis } = chart._fullLayout;
  const cursor = chart.querySelector(".cursor") ?? chart.appendChild(Object.assign(document.createElement("i"), { className: "cursor" }));
  const x = xaxis.l2p(at);
  cursor.hidden = x < 0 || x > xaxis._length;
  Object.assign(cursor.style, { left: `${xaxis._offset + x}px`, top: `${yaxis._offset}px`, height: `${yaxis._length}px` });
};
const nearest = (at) => {
  const byRun = new Map();
  for (const [time, anchor, run, frame, command, image] of pictures) {
    const caption = `${run}, frame ${frame}, ${time.toFixed(2)} s`;
    if (!byRun.has(run) || Math.abs(time - at) < Math.abs(byRun.get(run).time - at)) byRun.set(run, { time, anchor, caption, command, image });
  }
  return [...byRun.values()].slice(0, 2);
};
const select = (at) => {
  timed.forEach((chart) => moveCursor(chart, at));
  const found = nearest(at);
  viewer.hidden = !found.length;
  viewer.dataset.time = at.toFixed(2);
  viewer.querySelector("p").textContent = `${at.toFixed(2)} s`;
  viewer.querySelector("div").replaceChildren(...found.map(({ anchor, caption, command, image }) => {
    const figure = document.createElement("figure");
    const shown = new Image();
    shown.src = image || document.querySelector(`img[data-of="${anchor}"]`).src;
    const text = document.createElement("figcaption");
    text.append(caption, Object.assign(document.createElement("code"), { textContent: command }));
    figure.append(shown, text);
    return figure;
  }));
};
const link = (chart) => {
  const follow = (event) => select(Number(event.points[0].x));
  chart.on("plotly_hover", follow);
  chart.on("plotly_click", follow);
};
