"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  /* Okabe and Ito's, which differ for every kind of colour vision; what a colour means is always written beside it. */
  const colours = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#6b7884", "#8a7a4a", "#7a68b8", "#b8473f", "#4a8f92", "#9c6b30"];
  const colour = (method) => colours[Math.max(0, data.methods.indexOf(method)) % colours.length];
  const byId = (id) => document.getElementById(id);
  const finite = (value) => typeof value === "number" && Number.isFinite(value);

  /* Elements are made with text, never with markup: a name cannot become code. */
  function make(tag, attributes = {}, ...children) {
    const svg = ["svg", "g", "path", "circle", "line", "text", "rect", "title", "polyline"].includes(tag);
    const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
    for (const [key, value] of Object.entries(attributes)) {
      if (value !== null && value !== undefined && value !== false) element.setAttribute(key, value === true ? "" : value);
    }
    for (const child of children) if (child !== null) element.append(child);
    return element;
  }

  /* Media lie in the page as base64 text; a blob is made when one is first shown. */
  const blobs = new Map();
  function mediaUrl(id) {
    if (!blobs.has(id)) {
      const holder = byId(`media-${id}`);
      const bytes = Uint8Array.from(atob(holder.textContent), (c) => c.charCodeAt(0));
      blobs.set(id, URL.createObjectURL(new Blob([bytes], { type: holder.dataset.mime })));
    }
    return blobs.get(id);
  }

  /* ---- tables ---- */
  function sortBy(table, index, direction) {
    const sign = direction === "ascending" ? 1 : -1;
    const body = table.tBodies[0];
    const key = (row) => row.cells[index].dataset.value ?? "";
    const rows = [...body.rows].map((row, i) => [row, i]);
    rows.sort(([a, i], [b, j]) => {
      const x = key(a), y = key(b);
      if (x === "" || y === "") return (x === "") - (y === "") || i - j; // what has no value stays last
      const p = Number(x), q = Number(y);
      const order = Number.isNaN(p) || Number.isNaN(q) ? x.localeCompare(y, "en", { numeric: true }) : p - q;
      return sign * order || i - j;
    });
    body.append(...rows.map(([row]) => row));
    [...table.tHead.rows[0].cells].forEach((head, i) => {
      if (i === index) head.setAttribute("aria-sort", direction); else head.removeAttribute("aria-sort");
    });
  }
  function makeSortable(table) {
    [...table.tHead.rows[0].cells].forEach((head, index) => head.querySelector("button").addEventListener("click", () => {
      const before = head.getAttribute("aria-sort"), other = { ascending: "descending", descending: "ascending" };
      sortBy(table, index, before ? other[before] : head.dataset.first);
    }));
  }
  document.querySelectorAll("table.sortable").forEach(makeSortable);
  document.querySelectorAll(".swatch").forEach((dot) => { dot.style.background = colour(dot.dataset.method); });

  /* ---- chart ---- */
  const tip = byId("tip");
  function showTip(text, x, y) {
    tip.textContent = text;
    tip.hidden = false;
    const box = tip.getBoundingClientRect();
    tip.style.left = `${Math.max(8, Math.min(innerWidth - box.width - 8, x + 14))}px`;
    tip.style.top = `${y + box.height + 24 > innerHeight ? y - box.height - 12 : y + 14}px`;
  }
  const hideTip = () => { tip.hidden = true; };
  addEventListener("scroll", hideTip, { passive: true });

  const { panels, qualities, costs } = data.chart;
  const number = (value, column) => finite(value) ? (column.decimals > 0 && Math.abs(value) < 1e4 ? value.toFixed(column.decimals) : Math.round(value).toLocaleString("en")) : "none";
  function ticks(low, high, wanted) {
    const raw = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((m) => m * power >= raw);
    const out = [];
    for (let v = Math.ceil(low / step) * step; v <= high + step * 1e-9; v += step) out.push(Number(v.toPrecision(12)));
    return out;
  }
  function logTicks(low, high) {
    const out = [];
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e += 1) for (const m of [1, 2, 5]) {
      const v = m * 10 ** e;
      if (v >= low && v <= high) out.push(v);
    }
    return out.length > 7 ? out.filter((v) => /^1(e|0*$|$)|^0?\.0*1$/.test(String(v))) : out;
  }
  /* A free place for each name near its point: to the right, left, above, below, then farther out. */
  function placeNames(points, sizes, bounds) {
    const shared = (a, b) => Math.max(0, Math.min(a[2], b[2]) - Math.max(a[0], b[0])) * Math.max(0, Math.min(a[3], b[3]) - Math.max(a[1], b[1]));
    const angles = [0, 180, 90, 270, 45, 135, 315, 225, 20, 160, 340, 200, 65, 115, 245, 295].map((a) => (a * Math.PI) / 180);
    const marks = points.map(({ x, y }) => [x - 9, y - 9, x + 9, y + 9]), placed = [];
    points.forEach(({ x, y }, i) => {
      const [w, h] = sizes[i], taken = [...placed, ...marks.filter((_, j) => j !== i)];
      let best = [x - w / 2, y - h / 2, x + w / 2, y + h / 2], least = Infinity;
      for (const step of [1, 1.6, 2.4, 3.4, 4.6, 6, 7.6]) for (const angle of angles) {
        const cx = x + Math.cos(angle) * (12 * step + w / 2), cy = y - Math.sin(angle) * (12 * step + h / 2);
        const box = [cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2];
        if (box[0] < bounds[0] || box[1] < bounds[1] || box[2] > bounds[2] || box[3] > bounds[3]) continue;
        const cover = taken.reduce((sum, other) => sum + shared(box, other), 0);
        if (cover < least) { best = box; least = cover; }
      }
      placed.push(best);
    });
    return placed;
  }
  const pen = document.createElement("canvas").getContext("2d");
  function textWidth(text) { pen.font = "560 12.5px sans-serif"; return pen.measureText(text).width + 4; }

  function drawChart() {
    const quality = qualities.find((c) => c.key === byId("chart-quality").value);
    const cost = costs.find((c) => c.key === byId("chart-cost").value);
    const panel = panels.find((p) => p.quality === quality.key && p.cost === cost.key);
    byId("chart-front").textContent = panel ? panel.words : "Nothing was measured for this pair.";
    if (!panel) { byId("chart-body").replaceChildren(); return; }
    const narrow = byId("chart-body").clientWidth < 560, higher = panel.higher_is_better;
    const width = narrow ? 420 : 900, height = narrow ? 400 : 460, left = 56, right = 18, top = 34, bottom = 50;
    const dots = byId("chart-scenes").checked ? data.scenes.filter((scene) => panel.scenes.includes(scene.name)).flatMap((scene) => panel.points.map(({ method }) => {
      const values = scene.values[method] || {};
      return { method, scene: scene.name, x: values[cost.key], y: values[quality.key] };
    })).filter((p) => finite(p.x) && p.x > 0 && finite(p.y)) : [];
    const timed = panel.points.filter((p) => finite(p.cost_mean)), untimed = panel.points.filter((p) => !finite(p.cost_mean));
    const ys = [...panel.points.flatMap((p) => [p.quality_mean, p.quality_low, p.quality_high]), ...dots.map((p) => p.y)].filter(finite);
    const xs = [...timed.flatMap((p) => [p.cost_mean, p.cost_low, p.cost_high]), ...dots.map((p) => p.x)].filter((x) => finite(x) && x > 0);
    let y0 = Math.min(...ys), y1 = Math.max(...ys);
    if (!(y1 > y0)) { y0 -= 0.5; y1 += 0.5; }
    const pad = 0.1 * (y1 - y0); y0 -= pad; y1 += pad;
    const x0 = Math.min(...xs) / 1.35, x1 = Math.max(...xs) * 1.5;
    const strip = untimed.length ? (narrow ? 84 : 130) : 0;
    const px = (x) => left + strip + (Math.log(Math.max(x, x0) / x0) / Math.log(x1 / x0)) * (width - left - strip - right);
    const py = (y) => { const t = (y - y0) / (y1 - y0); return height - bottom - (higher ? t : 1 - t) * (height - top - bottom); };
    const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": `${quality.title} against ${cost.title}` });
    if (strip) svg.append(make("rect", { class: "strip", x: left, y: top, width: strip, height: height - top - bottom }));
    for (const v of ticks(y0, y1, 5)) svg.append(make("line", { class: "grid", x1: left, x2: width - right, y1: py(v), y2: py(v) }), make("text", { x: left - 8, y: py(v) + 4, "text-anchor": "end" }, String(v)));
    for (const v of logTicks(x0, x1)) svg.append(make("line", { class: "grid", x1: px(v), x2: px(v), y1: top, y2: height - bottom }), make("text", { x: px(v), y: height - bottom + 18, "text-anchor": "middle" }, v >= 1e4 ? v.toExponential(0).replace("+", "") : String(Number(v.toPrecision(3)))));
    const all = panel.scenes.length === panel.scenes_of_run ? panel.scenes.length : `${panel.scenes.length}/${panel.scenes_of_run}`;
    svg.append(make("text", { x: left - 44, y: 18 }, `${quality.title} ${higher ? "(higher is better)" : "(lower is better: axis upside down)"}`));
    svg.append(make("text", { x: width - right, y: height - 10, "text-anchor": "end" }, `${cost.title}, logarithmic; ${all} scenes`));
    if (strip) {
      const words = untimed.every((p) => p.published) ? ["published,", "not measured here"] : [cost.key === "bytes" ? "no model known" : "not measured here"];
      words.forEach((word, i) => svg.append(make("text", { class: "aside", x: left + strip / 2, y: height - bottom - 8 - 14 * (words.length - 1 - i), "text-anchor": "middle" }, narrow && word.startsWith("not") ? "not timed here" : word)));
    }
    for (const p of dots) svg.append(make("circle", { class: "dot", cx: px(p.x), cy: py(p.y), r: 3, fill: colour(p.method) }, make("title", {}, `${p.method}, ${p.scene}: ${number(p.y, quality)}, ${number(p.x, cost)} ${cost.title}`)));
    const best = panel.front.map((method) => panel.points.find((p) => p.method === method));
    const path = best.flatMap((p, i) => (i ? [[px(p.cost_mean), py(best[i - 1].quality_mean)]] : []).concat([[px(p.cost_mean), py(p.quality_mean)]]));
    if (best.length > 1) svg.append(make("polyline", { class: "front", points: path.map((at) => at.join(",")).join(" ") }));
    /* Front points come last, so that what hides them is drawn first. */
    const order = [...untimed, ...timed.filter((p) => !p.on_front), ...best];
    const at = order.map((p) => {
      const spread = (untimed.indexOf(p) + 0.5) / Math.max(1, untimed.length); // side by side, not on top of one another
      return { x: finite(p.cost_mean) ? px(p.cost_mean) : left + strip * (0.1 + 0.8 * spread), y: py(p.quality_mean) };
    });
    const boxes = placeNames(at, order.map((p) => [textWidth(p.short), 15]), [left + 2, 22, width - 2, height - bottom - 2]);
    order.forEach((p, i) => {
      const { x, y } = at[i], interval = (low, high, column) => (finite(low) ? ` [${number(low, column)}, ${number(high, column)}]` : "");
      const why = p.published ? "published, not measured here" : p.why_no_cost;
      const lines = [p.method, `${quality.title}: ${number(p.quality_mean, quality)}${interval(p.quality_low, p.quality_high, quality)}`, `${cost.title}: ${finite(p.cost_mean) ? number(p.cost_mean, cost) + interval(p.cost_low, p.cost_high, cost) : why}`];
      if (finite(p.quality_low)) svg.append(make("line", { class: "bar", stroke: colour(p.method), x1: x, x2: x, y1: py(p.quality_low), y2: py(p.quality_high) }));
      if (finite(p.cost_low)) svg.append(make("line", { class: "bar", stroke: colour(p.method), x1: px(p.cost_low), x2: px(p.cost_high), y1: y, y2: y }));
      const filled = p.on_front || !finite(p.cost_mean);
      const circle = make("circle", { class: filled ? "mean" : "mean hollow", cx: x, cy: y, r: 7, fill: filled ? colour(p.method) : null, stroke: filled ? null : colour(p.method), tabindex: 0, role: "img", "aria-label": lines.join(", "), "data-method": p.method });
      const show = () => { const box = circle.getBoundingClientRect(); showTip(lines.join("\n"), box.right, box.bottom); byId("chart-text").textContent = lines.join(" · "); };
      circle.addEventListener("pointerenter", show);
      circle.addEventListener("focus", show);
      circle.addEventListener("click", show);
      circle.addEventListener("pointerleave", hideTip);
      circle.addEventListener("blur", hideTip);
      const [x0b, y0b, x1b, y1b] = boxes[i], near = [Math.min(Math.max(x, x0b), x1b), Math.min(Math.max(y, y0b), y1b)];
      if (Math.hypot(near[0] - x, near[1] - y) > 13.5) svg.append(make("line", { class: "leader", stroke: colour(p.method), x1: x, y1: y, x2: near[0], y2: near[1] }));
      svg.append(circle, make("text", { class: "name", x: (x0b + x1b) / 2, y: y1b - 4, "text-anchor": "middle" }, p.short));
    });
    byId("chart-body").replaceChildren(svg);
    hideTip();
  }
  if (panels.length) {
    byId("chart-quality").append(...qualities.map((c) => make("option", { value: c.key }, c.title)));
    byId("chart-cost").append(...costs.map((c) => make("option", { value: c.key }, c.title)));
    const wanted = ["psnr", "visible_psnr", "input_psnr"].find((key) => qualities.some((c) => c.key === key));
    if (wanted) byId("chart-quality").value = wanted;
    for (const id of ["chart-quality", "chart-cost", "chart-scenes"]) byId(id).addEventListener("change", drawChart);
    new ResizeObserver(drawChart).observe(byId("chart-body"));
    drawChart();
  } else {
    byId("chart").hidden = true;
  }

  /* ---- one clock for every video of a scene ---- */
  class Clock {
    constructor(frames, fps, onFrame) {
      Object.assign(this, { frames, fps, onFrame, frame: 0, videos: [], playing: false });
    }
    add(video) { this.videos.push(video); video.addEventListener("loadeddata", () => this.place(video)); }
    time() { return (this.frame + 0.5) / this.fps; }
    place(video) { if (Math.abs(video.currentTime - this.time()) > 0.01) video.currentTime = this.time(); }
    go(frame) {
      this.frame = Math.max(0, Math.min(this.frames - 1, frame));
      this.videos.forEach((video) => this.place(video));
      this.onFrame(this.frame);
    }
    /* Frame by frame, all together: the next frame waits for the slowest video, so none is ever ahead of another. */
    async play() {
      this.playing = true;
      while (this.playing) {
        const due = performance.now() + 1000 / this.fps;
        this.go((this.frame + 1) % this.frames);
        await Promise.all(this.videos.map((video) => this.settled(video)));
        await new Promise((resume) => setTimeout(resume, Math.max(0, due - performance.now())));
      }
    }
    settled(video) {
      if (!video.seeking) return null;
      return new Promise((resume) => {
        video.addEventListener("seeked", resume, { once: true });
        setTimeout(resume, 2000); // a video that cannot be decoded must not stop the others
      });
    }
    pause() {
      this.playing = false;
    }
  }

  /* ---- scenes ---- */
  let clock = null;
  const remembered = { left: null, right: null, split: 50 };

  function figure(content, caption) { return make("figure", {}, content, make("figcaption", {}, caption)); }
  function video(scene, method) {
    const element = make("video", { muted: true, playsinline: true, preload: "auto", "aria-label": `${method} on ${scene.name}`, "data-method": method });
    element.muted = true;
    if (scene.frame_size) { element.width = scene.frame_size[0]; element.height = scene.frame_size[1]; }
    element.src = mediaUrl(scene.videos[method]);
    clock.add(element);
    return element;
  }

  function compare(scene, methods) {
    const pick = (side, fallback) => methods.includes(remembered[side]) ? remembered[side] : fallback;
    const chosen = { left: pick("left", methods[0]), right: pick("right", methods[Math.min(1, methods.length - 1)]) };
    const box = make("div", { class: "compare" });
    const slider = make("input", { type: "range", min: 0, max: 100, step: "any", value: remembered.split, "aria-label": "Divide between the two methods", id: "split" });
    const handle = make("div", { class: "handle" });
    const tags = { left: make("span", { class: "tag left" }), right: make("span", { class: "tag right" }) };
    if (scene.frame_size) box.style.aspectRatio = `${scene.frame_size[0]} / ${scene.frame_size[1]}`;
    let upper = null;
    const split = () => {
      remembered.split = Number(slider.value);
      upper.style.clipPath = `inset(0 ${100 - remembered.split}% 0 0)`;
      handle.style.left = `${remembered.split}%`;
    };
    const fill = () => {
      clock.videos = clock.videos.filter((v) => !box.contains(v));
      const lower = video(scene, chosen.right);
      upper = video(scene, chosen.left);
      tags.left.textContent = chosen.left;
      tags.right.textContent = chosen.right;
      box.replaceChildren(lower, upper, handle, tags.left, tags.right);
      split();
    };
    const select = (side) => {
      const list = make("select", { id: `${side}-method` }, ...methods.map((method) => make("option", { value: method }, method)));
      list.value = chosen[side];
      list.addEventListener("change", () => { chosen[side] = remembered[side] = list.value; fill(); });
      return make("label", {}, side === "left" ? "Left" : "Right", list);
    };
    const drag = (event) => {
      const area = box.getBoundingClientRect();
      slider.value = Math.max(0, Math.min(100, (100 * (event.clientX - area.left)) / area.width));
      split();
    };
    box.addEventListener("pointerdown", (event) => { box.setPointerCapture(event.pointerId); drag(event); });
    box.addEventListener("pointermove", (event) => { if (box.hasPointerCapture(event.pointerId)) drag(event); });
    slider.addEventListener("input", split);
    fill();
    return make("div", {}, make("div", { class: "controls" }, select("left"), select("right")), box, make("div", { class: "compare-row" }, slider));
  }

  function player(scene) {
    const frames = scene.indices.length;
    const button = make("button", { type: "button", class: "button", id: "play" }, "Play");
    const slider = make("input", { type: "range", min: 0, max: frames - 1, step: 1, value: 0, "aria-label": "Frame", id: "frame" });
    const output = make("output", { for: "frame" });
    clock.onFrame = (frame) => { slider.value = frame; output.textContent = `frame ${scene.indices[frame]} · ${frame + 1}/${frames}`; };
    slider.addEventListener("input", () => { if (clock.playing) toggle(); clock.go(Number(slider.value)); });
    const toggle = () => { if (clock.playing) clock.pause(); else void clock.play(); button.textContent = clock.playing ? "Pause" : "Play"; };
    button.addEventListener("click", toggle);
    clock.onFrame(0);
    return make("div", { class: "player" }, button, slider, output);
  }

  function scores(scene) {
    const columns = data.columns.filter((c) => data.methods.some((m) => finite((scene.values[m] || {})[c.key])));
    const head = make("tr", {}, make("th", { scope: "col", "data-first": "ascending" }, make("button", { type: "button" }, "Method")));
    const arrow = (c) => (c.higher === null ? "" : c.higher ? "\u00a0↑" : "\u00a0↓");
    head.append(...columns.map((c) => make("th", { scope: "col", class: "number", "data-first": c.higher ? "descending" : "ascending" }, make("button", { type: "button" }, c.title + arrow(c)))));
    const rows = data.methods.filter((m) => scene.values[m] || scene.failures[m]).map((method) => {
      const dot = make("span", { class: "swatch" });
      dot.style.background = colour(method);
      const row = make("tr", {}, make("th", { scope: "row", "data-value": method }, dot, method));
      for (const c of columns) {
        const value = (scene.values[method] || {})[c.key];
        const word = scene.failures[method] ? "fail" : "n/a";
        row.append(make("td", { class: "number", "data-value": finite(value) ? value : "" }, finite(value) ? number(value, c) : word));
      }
      return row;
    });
    const table = make("table", { class: "sortable" }, make("thead", {}, head), make("tbody", {}, ...rows));
    makeSortable(table);
    return make("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": `Scores of ${scene.name}` }, table);
  }

  /* Anchors by stage as one bar; below it a bar a repair: how large the hole was, and what covered it before and after. */
  function ledger(method, record) {
    const stages = Object.entries(record.stages), total = stages.reduce((sum, [, n]) => sum + n, 0);
    const tints = { original: "#2f7fa8", outpainted: "#7a68b8", repaired: "#c8782a" };
    const repairs = record.repairs || [], width = 640, height = repairs.length ? 190 : 58;
    const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${method}: ${stages.map(([s, n]) => `${n} anchors ${s}`).join(", ")}` });
    let x = 0;
    for (const [stage, n] of stages) {
      const w = total ? (width * n) / total : 0;
      svg.append(make("rect", { x, y: 0, width: Math.max(0, w - 2), height: 18, rx: 3, fill: tints[stage] || "#888" }, make("title", {}, `${stage}: ${n}`)));
      x += w;
    }
    x = 0;
    for (const [stage, n] of stages) {
      const label = `${n.toLocaleString("en")} ${stage}`;
      svg.append(make("circle", { cx: x + 5, cy: 36, r: 4.5, fill: tints[stage] || "#888" }), make("text", { x: x + 14, y: 40 }, label));
      x += 30 + label.length * 6.6;
    }
    if (repairs.length) {
      const most = Math.max(...repairs.map((r) => Math.sqrt(r.area || 0)), 1), step = width / repairs.length;
      svg.append(make("text", { x: 0, y: 68 }, "repairs in order; height: root of the hole's area; filled: what was covered after"));
      repairs.forEach((r, i) => {
        const h = (100 * Math.sqrt(r.area || 0)) / most, fill = r.decision === "generative" ? tints.outpainted : tints.repaired;
        const w = Math.max(1, Math.min(26, step - 2)), after = Math.max(0, Math.min(1, r.coverage_after ?? 0));
        const words = `repair ${r.iteration}, view ${r.view}: ${r.area} px, ${r.decision}. ${r.reason ?? ""}. ${r.anchors_added} anchors; coverage ${(r.coverage_before ?? 0).toFixed(2)} to ${after.toFixed(2)}`;
        svg.append(make("g", {}, make("title", {}, words), make("rect", { x: i * step, y: 180 - h, width: w, height: h, rx: 2, fill, opacity: 0.28 }), make("rect", { x: i * step, y: 180 - h * after, width: w, height: h * after, rx: 2, fill })));
      });
    }
    const count = record.repairs ? record.repairs.length : record.count;
    const facts = [finite(count) ? `${count} repair${count === 1 ? "" : "s"}` : null, record.stopped ? `stopped: ${record.stopped}` : null, record.repairs ? null : "this run kept no ledger of single repairs"].filter(Boolean);
    const parts = [svg];
    if (record.picture !== undefined) parts.push(make("img", { class: "ledger-picture", src: mediaUrl(record.picture), alt: `${method}, repaired views: what was missing, which rule decided, the view afterwards` }));
    return make("figure", { class: "ledger chart" }, ...parts, make("figcaption", {}, `${method}: ${facts.join("; ")}`));
  }

  function still(scene, key, caption) {
    const image = make("img", { src: mediaUrl(scene[key]), alt: `${key} of ${scene.name}` });
    return figure(image, caption);
  }

  function showScene(index) {
    const scene = data.scenes[index];
    if (clock) clock.pause();
    clock = new Clock((scene.indices || [0]).length, scene.fps, () => {});
    const methods = data.methods.filter((method) => scene.videos[method] !== undefined);
    const out = [make("h3", {}, scene.name)];
    const stills = make("div", { class: "stills" });
    if (scene.input !== undefined) stills.append(still(scene, "input", `Input, ${scene.size[0]}×${scene.size[1]}`), still(scene, "depth", scene.depth_text));
    const stage = make("div", {}, methods.length ? make("div", { class: "duo" }, compare(scene, methods), stills) : stills);
    out.push(stage);
    const wall = data.methods.filter((m) => methods.includes(m) || scene.failures[m]).map((method) => {
      return figure(methods.includes(method) ? video(scene, method) : make("div", { class: "failed" }, scene.failures[method]), method);
    });
    if (wall.length) stage.append(make("h3", {}, "All methods at the same frame"), make("div", { class: "wall" }, ...wall));
    if (methods.length) stage.append(player(scene));
    const notes = data.methods.flatMap((m) => (scene.notes[m] || []).map((note) => make("li", {}, `${m}: ${note}`)));
    if (notes.length) out.push(make("details", {}, make("summary", {}, "What to know of these frames"), make("ul", { class: "small" }, ...notes)));
    out.push(make("h3", {}, "Scores of this scene"), scores(scene));
    const ledgers = Object.entries(scene.ledgers);
    if (ledgers.length) out.push(make("h3", {}, "Repair ledger"), ...ledgers.map(([method, record]) => ledger(method, record)));
    byId("scene").replaceChildren(...out);
    [...byId("scene-list").children].forEach((button, i) => {
      button.setAttribute("aria-checked", String(i === index));
      button.tabIndex = i === index ? 0 : -1;
    });
  }

  data.scenes.forEach((scene, index) => {
    const picture = scene.input === undefined ? make("span", { class: "blank" }) : make("img", { src: mediaUrl(scene.input), alt: "", loading: "lazy" });
    const button = make("button", { type: "button", role: "radio" }, picture, make("span", {}, scene.name));
    button.addEventListener("click", () => showScene(index));
    button.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      const next = (index + step + data.scenes.length) % data.scenes.length;
      showScene(next);
      byId("scene-list").children[next].focus();
    });
    byId("scene-list").append(button);
  });
  if (data.scenes.length) showScene(0);

  /* ---- stability ---- */
  document.querySelectorAll("button.cell").forEach((cell) => {
    const show = () => { byId("stability-text").textContent = cell.dataset.detail; };
    cell.title = cell.dataset.detail;
    cell.addEventListener("click", show);
    cell.addEventListener("focus", show);
  });
})();
