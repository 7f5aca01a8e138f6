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
const LINES = ["--blue", "--amber", "--teal", "--rose", "--violet", "--none"];
const MARKS = { motion: "--good", enable: "--teal", stop: "--text", warning: "--doubt", error: "--bad" };
const FONT = "12px system-ui, sans-serif";
const number = value => value == null ? "–" : String(+value.toPrecision(7));

// A packed column: 32 bits a value between the least and the greatest, the highest number where there is none.
const unpack = column => {
  if (Array.isArray(column)) return column;
  const whole = new Uint32Array(Uint8Array.from(atob(column.text), each => each.charCodeAt(0)).buffer);
  const step = (column.high - column.low) / 4294967294;
  return Array.from(whole, each => each === 4294967295 ? null : column.low + each * step);
};

// Times as they are shown: a clock (its zone is part of the value), or seconds.
const two = value => String(value).padStart(2, "0");
const clock = (seconds, digits) => {
  const date = new Date(Math.round(seconds * 1000)), time = [date.getUTCHours(), date.getUTCMinutes(), date.getUTCSeconds()];
  if (Number.isNaN(date.getTime())) return "–";
  return time.map(two).join(":") + (digits ? "." + String(date.getUTCMilliseconds()).padStart(3, "0").slice(0, digits) : "");
};
const day = seconds => new Date(seconds * 1000).toISOString().slice(0, 10);
const ticks = (plot, splits, _, space, step) => splits.map((each, at) => {
  const text = step >= 60 ? clock(each, 0).slice(0, 5) : clock(each, step >= 1 ? 0 : 3);
  return at && day(each) !== day(splits[at - 1]) ? day(each).slice(5) : text;
});
// Millions are shortened, as long as that tells one from the next.
const short = new Intl.NumberFormat("en", { notation: "compact", maximumFractionDigits: 2 });
const full = new Intl.NumberFormat("en", { maximumFractionDigits: 9 });
const amounts = (plot, splits, _, space, step) => splits.map(each =>
  each == null ? "" : (step >= 1e4 && Math.max(...splits.map(Math.abs)) >= 1e6 ? short : full).format(each));
const AXES = {
  clock: { value: each => each == null ? "–" : clock(each, 3), time: true },
  elapsed: { value: each => each == null ? "–" : `${number(each)} s`, tick: each => `${number(each)} s` },
  frames: { value: each => each == null ? "–" : `#${Math.round(each)}`, tick: each => `#${each}` },
  log: { value: each => each == null ? "–" : `${+each.toPrecision(3)} ms`, distr: 3 },
};

// Plots of one group show the same stretch; `whole` is all of it.
const groups = new Map();
const group = name => {
  if (!groups.has(name)) groups.set(name, { plots: [], whole: [Infinity, -Infinity], shown: null });
  return groups.get(name);
};
const show = (all, low, high) => {
  const [first, last] = all.whole;
  if (!(high > low) || (low <= first && high >= last)) [low, high] = [first, last];
  all.shown = [low, high];
  for (const plot of all.plots) plot.setScale("x", { min: low, max: high });
  all.told?.(low, high);
};
const move = (all, by) => {
  const [low, high] = all.shown ?? all.whole, step = (high - low) * by;
  const far = Math.min(Math.max(step, all.whole[0] - low), all.whole[1] - high);
  show(all, low + far, high + far);
};
const scale = (all, by, at) => {
  const [low, high] = all.shown ?? all.whole, middle = at ?? (low + high) / 2;
  show(all, Math.max(all.whole[0], middle - (middle - low) * by), Math.min(all.whole[1], middle + (high - middle) * by));
};

// Marks: a line at each time, with a sign at its top, and its name where there is room up to the next one. The nearest one is told
// below the plots.
const drawMarks = marks => plot => {
  const { ctx, bbox } = plot, { min, max } = plot.scales.x, size = 4 * devicePixelRatio;
  const shown = marks.flatMap(mark => mark.at.filter(x => x >= min && x <= max)
    .map(x => ({ left: Math.round(plot.valToPos(x, "x", true)), mark }))).sort((one, other) => one.left - other.left);
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left - size, bbox.top, bbox.width + 2 * size, bbox.height);
  ctx.clip();
  ctx.lineWidth = devicePixelRatio;
  ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textBaseline = "top";
  ctx.textAlign = "left";
  shown.forEach(({ left, mark }, n) => {
    ctx.strokeStyle = ctx.fillStyle = colour(MARKS[mark.kind] ?? "--none");
    // Many lines would hide what they mark.
    ctx.globalAlpha = shown.length * 2 * size > bbox.width ? 0.12 : 0.3;
    ctx.beginPath();
    ctx.moveTo(left, bbox.top);
    ctx.lineTo(left, bbox.top + bbox.height);
    ctx.stroke();
    ctx.globalAlpha = 0.9;
    ctx.beginPath();
    ctx.moveTo(left - size, bbox.top);
    ctx.lineTo(left + size, bbox.top);
    ctx.lineTo(left, bbox.top + 1.6 * size);
    ctx.fill();
    const end = n + 1 < shown.length ? shown[n + 1].left - size : bbox.left + bbox.width;
    if (left + 1.5 * size + ctx.measureText(mark.label).width < end) ctx.fillText(mark.label, left + 1.5 * size, bbox.top + 1);
  });
  ctx.restore();
};
const tellMarks = (marks, place, axis) => plot => {
  const at = plot.cursor.left;
  if (at == null || at < 0) return;
  let best = null, distance = 7;
  for (const mark of marks) mark.at.forEach((x, n) => {
    const far = Math.abs(plot.valToPos(x, "x") - at);
    if (far < distance) [best, distance] = [[mark, n, x], far];
  });
  place.textContent = best ? `${axis.value(best[2])}  ${best[0].label} ${best[0].texts[best[1]]}` : "";
};

// Round steps of a clock, in seconds.
const STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200,
  10800, 21600, 43200, 86400, 172800, 604800, 2592000];
const FROM_ZERO = (_, low, high) => [0, uPlot.rangeNum(0, high || 1, 0.1, true)[1]];
const plots = [];
const width = place => Math.max(200, Math.min(place.classList.contains("long") ? 1400 : 900, place.clientWidth || 900));
const height = place => place.classList.contains("long") ? 170 : 250;
const draw = place => {
  if (place.dataset.drawn) return;
  place.dataset.drawn = "yes";
  const about = JSON.parse(place.querySelector("script").textContent), data = about.data.map(unpack);
  const label = (name, unit) => unit ? `${name} (${unit})` : name;
  const axis = (name, unit) => ({
    label: label(name, unit), stroke: () => colour("--text"), size: 60, font: FONT, labelFont: FONT,
    grid: { stroke: () => colour("--line"), width: 1 }, ticks: { stroke: () => colour("--line"), width: 1 },
  });
  const value = unit => (_, each) => each == null ? "–" : `${number(each)} ${unit}`;
  const seen = about.lines.filter(line => !line.dashed);
  const long = about.axis !== undefined, shape = AXES[about.axis] ?? { value: each => value(about.xUnit)(null, each) };
  const paint = (line, n) => line.dashed ? "--none" : (about.colour && n === 0 ? about.colour : LINES[seen.indexOf(line) % LINES.length]);
  const series = about.lines.map((line, n) => ({
    label: line.name, stroke: () => colour(paint(line, n)), width: long ? 1.5 : 2, dash: line.dashed ? [6, 4] : undefined,
    points: long ? { size: 5, ...(about.look === "steps" ? { show: false } : {}) } : { show: !line.dashed && data[0].length < 200 }, spanGaps: !long,
    fill: about.look === "steps" ? () => colour(paint(line, n)) + "30" : undefined,
    paths: about.look === "steps" ? uPlot.paths.stepped({ align: 1 }) : undefined,
    value: (_, each) => value(about.yUnit)(_, each),
  }));
  const below = { ...axis(about.x, about.xUnit), size: 46 };
  if (about.axis === "clock") Object.assign(below, { label: undefined, values: ticks, size: 26, incrs: STEPS, space: (_, n, low, high) => high - low < 5 ? 100 : 72 });
  else if (long) Object.assign(below, { size: 26, label: undefined });
  if (shape.tick) below.values = (_, splits) => splits.map(shape.tick);
  if (about.axis === "log") below.values = (_, splits) => splits.map(each => Number.isInteger(+Math.log10(each).toFixed(6)) ? (each < 1000 ? `${+each.toPrecision(3)} ms` : `${each / 1000} s`) : "");
  const options = {
    width: width(place), height: height(place), axes: [below, { ...axis(about.y, about.yUnit), size: long ? 80 : 60, values: amounts }],
    scales: { x: { time: shape.time ?? false, distr: shape.distr ?? 1 }, y: about.look === "line" || !long ? {} : { range: FROM_ZERO } }, hooks: {},
    ...(long ? { padding: [8, 28, 0, 0] } : {}),
    series: [{ label: about.x, value: (_, each) => shape.value(each) }, ...series],
  };
  if (long) options.tzDate = seconds => uPlot.tzDate(new Date(seconds * 1000), "Etc/UTC");
  const all = about.group ? group(about.group) : null, box = place.closest(".drive"), held = box?.querySelector("script.marks");
  if (all) {
    options.cursor = { sync: { key: about.group }, drag: { x: true, y: false, setScale: false } };
    options.hooks.setSelect = [plot => {
      const { left, width } = plot.select;
      // The others of the group are told of it, too.
      if (width > 2 && all.pulled === plot) show(all, plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
      plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    }];
    options.cursor.bind = { dblclick: () => () => { show(all, ...all.whole); return null; } };
  }
  if (held) {
    box.marks ??= JSON.parse(held.textContent).map(mark => ({ ...mark, at: unpack(mark.x) }));
    options.hooks.draw = [drawMarks(box.marks)];
    options.hooks.setCursor = [tellMarks(box.marks, box.querySelector(".told span"), shape)];
  }
  const plot = new uPlot(options, data, place);
  plots.push(plot);
  if (!all) return;
  all.plots.push(plot);
  const [min, max] = all.shown ?? all.whole;
  plot.setScale("x", { min, max });
  const over = plot.over;
  over.addEventListener("wheel", event => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    scale(all, event.deltaY < 0 ? 0.75 : 1 / 0.75, plot.posToVal(event.offsetX, "x"));
  }, { passive: false });
  // With Shift a plot is pulled along instead of a stretch being chosen.
  over.addEventListener("mousedown", event => {
    all.pulled = plot;
    if (!event.shiftKey) return;
    event.stopImmediatePropagation();
    let from = event.clientX;
    const pull = next => {
      const [low, high] = all.shown ?? all.whole;
      move(all, (from - next.clientX) / over.clientWidth);
      from = next.clientX;
      return [low, high];
    };
    const done = () => { removeEventListener("mousemove", pull); removeEventListener("mouseup", done); };
    addEventListener("mousemove", pull);
    addEventListener("mouseup", done);
  }, { capture: true });
};

for (const tools of document.querySelectorAll(".tools")) {
  const all = group(tools.dataset.group), told = tools.querySelector("output");
  all.whole = [+tools.dataset.low, +tools.dataset.high];
  all.told = (low, high) => {
    const whole = all.whole[0] === low && all.whole[1] === high, of = all.plots[0]?.series[0].value;
    told.textContent = whole || !of ? "" : `${of(null, low)} to ${of(null, high)}`;
  };
  const deeds = {
    all: () => show(all, ...all.whole), in: () => scale(all, 0.5), out: () => scale(all, 2), back: () => move(all, -0.4), on: () => move(all, 0.4),
  };
  for (const button of tools.querySelectorAll("button"))
    button.addEventListener("click", deeds[button.dataset.do] ?? (() => show(all, +button.dataset.low, +button.dataset.high)));
}

// What is seen is drawn first, the rest while nothing else is to do; nothing is drawn into a closed box.
const places = [...document.querySelectorAll(".plot")];
const open = place => !place.closest("details:not([open])");
const soon = what => globalThis.requestIdleCallback ? requestIdleCallback(what, { timeout: 50 }) : setTimeout(what, 1);
const rest = () => {
  const next = places.find(place => !place.dataset.drawn && open(place));
  if (!next) return;
  draw(next);
  soon(rest);
};
for (const place of places) {
  const box = place.getBoundingClientRect();
  if (open(place) && box.top < innerHeight && box.bottom > 0) draw(place);
}
soon(rest);
for (const box of document.querySelectorAll("details")) box.addEventListener("toggle", () => box.open && rest());

// A time of a table leads to its place on the plots.
for (const link of document.querySelectorAll("[data-zoom]"))
  link.addEventListener("click", () => {
    const all = group(link.dataset.group), at = +link.dataset.zoom, room = (all.whole[1] - all.whole[0]) / 60;
    show(all, Math.max(all.whole[0], at - room), Math.min(all.whole[1], at + room));
  });

const redraw = () => plots.forEach(plot => plot.redraw(false));
addEventListener("resize", () => plots.forEach(p => p.setSize({ width: width(p.root.parentNode), height: height(p.root.parentNode) })));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
addEventListener("beforeprint", () => {
  document.documentElement.classList.add("printing");
  places.filter(open).forEach(draw);
  redraw();
});
addEventListener("afterprint", () => { document.documentElement.classList.remove("printing"); redraw(); });
