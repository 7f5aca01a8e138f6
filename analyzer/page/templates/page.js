"use strict";
// Rows that can be searched: every word must stand in the row, or be one of its marks (data-marks).
for (const table of document.querySelectorAll("table[data-search]")) {
  const input = document.getElementById(table.dataset.search), told = document.getElementById(table.dataset.search + "-count");
  const rows = [...table.tBodies[0].rows];
  const show = () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const row of rows) {
      const marks = row.dataset.marks.toLowerCase().split(" "), text = row.textContent.toLowerCase();
      row.hidden = !words.every(word => word.includes(":") ? marks.includes(word) : text.includes(word));
      count += !row.hidden;
    }
    told.textContent = `${count} of ${rows.length}`;
  };
  input.addEventListener("input", show);
  // A link to a row shows it; a link with words searches for them.
  document.addEventListener("click", event => {
    const link = event.target.closest("a[href^='#']");
    if (!link) return;
    const row = document.getElementById(link.hash.slice(1));
    if (link.dataset.find !== undefined) input.value = link.dataset.find;
    else if (row && row.closest("table") === table && row.hidden) input.value = "";
    else return;
    show();
  });
  show();
}

// Plots. Colours are read at each drawing, so that a page follows its reader, and its printer.
const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const LINES = ["--seen", "--doubt", "--good", "--bad", "--none"];
const number = value => value == null ? "–" : String(+value.toPrecision(5));
const plots = [];
for (const place of document.querySelectorAll(".plot")) {
  const about = JSON.parse(place.querySelector("script").textContent);
  const label = (name, unit) => unit ? `${name} (${unit})` : name;
  const axis = (name, unit) => ({
    label: label(name, unit), stroke: () => colour("--text"), size: 60, font: "12px system-ui, sans-serif",
    labelFont: "12px system-ui, sans-serif",
    grid: { stroke: () => colour("--line"), width: 1 }, ticks: { stroke: () => colour("--line"), width: 1 },
  });
  const value = unit => (_, each) => each == null ? "–" : `${number(each)} ${unit}`;
  const seen = about.lines.filter(line => !line.dashed);
  const series = about.lines.map(line => ({
    label: line.name, stroke: () => colour(line.dashed ? "--none" : LINES[seen.indexOf(line) % LINES.length]), width: 2,
    dash: line.dashed ? [6, 4] : undefined, points: { show: !line.dashed && about.data[0].length < 200 }, spanGaps: true,
    value: value(about.yUnit),
  }));
  plots.push(new uPlot({
    width: Math.min(900, place.clientWidth || 900), height: 250, scales: { x: { time: false } },
    axes: [{ ...axis(about.x, about.xUnit), size: 46 }, axis(about.y, about.yUnit)],
    series: [{ label: about.x, value: value(about.xUnit) }, ...series],
  }, about.data, place));
}
const redraw = () => plots.forEach(plot => plot.redraw(false));
addEventListener("resize", () => plots.forEach(p => p.setSize({ width: Math.min(900, p.root.parentNode.clientWidth), height: 250 })));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
addEventListener("beforeprint", () => { document.documentElement.classList.add("printing"); redraw(); });
addEventListener("afterprint", () => { document.documentElement.classList.remove("printing"); redraw(); });
