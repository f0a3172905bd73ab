(function () {
  "use strict";
  var data = JSON.parse(document.getElementById("data").textContent);
  var NS = "http://www.w3.org/2000/svg";
  var VIRIDIS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];
  var NAMES = { "CartPole-v1": "CartPole", "FrozenLake-v1": "FrozenLake", "trl_explore/Catch-v0": "Catch" };
  var state = { task: 0, corrected: 0, T: 1, measure: "passed", colour: "rate", w: null, decays: false };
  var map = document.getElementById("map");
  function $(id) { return document.getElementById(id); }
  function css(name) { return getComputedStyle(document.documentElement).getPropertyValue(name).trim(); }
  function el(name, attributes, parent, text) {
    var made = document.createElementNS(NS, name);
    for (var key in attributes) made.setAttribute(key, attributes[key]);
    if (text !== undefined) made.textContent = text;
    if (parent) parent.appendChild(made);
    return made;
  }
  function same(a, b) { return a.every(function (x, i) { return Math.abs(x - b[i]) < 1e-3; }); }
  function percent(x) { return (x > 0 && x < 0.01 ? (100 * x).toFixed(1) : Math.round(100 * x)) + "\u00a0%"; }
  function number(x) { return x === null ? "?" : x === 0 ? "0" : Math.abs(x) >= 100 ? x.toFixed(0) : Math.abs(x) >= 10 ? x.toFixed(1) : x.toFixed(2); }
  function exact(x) { return (100 * x).toFixed(1) + "\u00a0%"; }
  function interval(v, how) { return v ? how(v[0]) + " [" + how(v[1]) + ", " + how(v[2]) + "]" : "cannot be told: training stopped first"; }

  // The cells of the present choices; without softmax in the mixture, T does not matter.
  function shown() {
    var found = [];
    data.cells.forEach(function (cell) {
      if (cell.task !== state.task || cell.corrected !== state.corrected) return;
      if (cell.T !== state.T && cell.w[1] > 0) return;
      found.push(cell);
    });
    return found;
  }
  function place(cell) {  // argmax left, uniform right, softmax above; others below the line
    if (cell.decays) return [262, 378];
    if (!onGrid(cell) && cell.w[1] < 1e-6) return [30 + 340 * cell.w[2], 378];
    return [30 + 340 * (cell.w[2] + cell.w[1] / 2), 320 - 340 * cell.w[1] * Math.sqrt(3) / 2];
  }
  var STEP = (function () {
    var best = 1;
    data.cells.forEach(function (cell) {
      if (!cell.decays && cell.w[1] > 1e-6) best = Math.min(best, cell.w[1]);
    });
    return best;
  })();
  function onGrid(cell) {
    return !cell.decays && cell.w.every(function (w) { return Math.abs(w / STEP - Math.round(w / STEP)) < 1e-2; });
  }
  function thesis(cell) {
    if (cell.decays) return "decaying \u03b5-greedy";
    if (same(cell.w, [1, 0, 0])) return "argmax";
    if (same(cell.w, [0, 0, 1])) return "random";
    if (same(cell.w, [0, 1, 0]) && cell.T === 1) return "softmax";
    if (same(cell.w, [0.7, 0, 0.3])) return "\u03b5-greedy";
    return "";
  }
  function label(cell) {
    if (cell.decays) return "decaying \u03b5-greedy: \u03b5 = 0.99\u207f in iteration n";
    var names = ["argmax", "softmax", "uniform"];
    var parts = cell.w.map(function (w, i) { return w > 0 ? Math.round(100 * w) + " % " + names[i] : ""; });
    var own = thesis(cell);
    return (own ? own + ": " : "") + parts.filter(Boolean).join(", ") + (cell.w[1] > 0 ? ", T = " + cell.T : "");
  }
  function value(cell) {
    var own = cell[state.measure][state.colour];
    return own ? own[0] : null;
  }
  function scale(x) {  // 0 to 1: bad to good
    var cap = data.tasks[state.task].cap;
    return state.colour === "rate" ? x : 1 - x / cap;
  }
  function colour(x) {
    var t = Math.max(0, Math.min(1, x)) * (VIRIDIS.length - 1), k = Math.min(VIRIDIS.length - 2, Math.floor(t));
    function part(i, c) { return parseInt(VIRIDIS[i].substr(1 + 2 * c, 2), 16); }
    return "rgb(" + [0, 1, 2].map(function (c) { return Math.round(part(k, c) + (t - k) * (part(k + 1, c) - part(k, c))); }).join(",") + ")";
  }
  function hexagon(x, y, r) {
    var path = "";
    for (var i = 0; i < 6; i++) {
      var a = Math.PI / 3 * i + Math.PI / 6;
      path += (i ? "L" : "M") + (x + r * Math.cos(a)).toFixed(2) + " " + (y + r * Math.sin(a)).toFixed(2);
    }
    return path + "Z";
  }
  function chosen(cells) {
    var found = cells.filter(function (c) { return c.decays === state.decays && (c.decays || (state.w && same(c.w, state.w))); });
    return found[0] || cells[0];
  }
  function text(cell) {
    var v = value(cell);
    return v === null ? "?" : state.colour === "rate" ? Math.round(100 * v) + "%" : Math.round(v);
  }

  function drawMap() {
    var cells = shown(), now = chosen(cells), r = 340 * STEP / Math.sqrt(3);
    map.textContent = "";
    var steps = Math.round(1 / STEP);
    for (var s = 0; s <= steps; s++) for (var u = 0; u + s <= steps; u++) {
      var at = place({ w: [1 - (s + u) / steps, s / steps, u / steps] });
      el("path", { d: hexagon(at[0], at[1], r), "class": "empty" }, map);
    }
    cells.slice().sort(function (a, b) { return onGrid(b) - onGrid(a); }).forEach(function (cell) {
      var at = place(cell), v = value(cell), fill = v === null ? css("--none") : colour(scale(v)), grid = onGrid(cell);
      var g = el("g", {
        "class": "cell" + (cell === now ? " chosen" : ""), role: "button", tabindex: cell === now ? 0 : -1,
        "aria-pressed": cell === now,
        "aria-label": label(cell) + "; " + (v === null ? "unknown" : state.colour === "rate" ? percent(v) + " " + state.measure : Math.round(v) + " iterations")
      }, map);
      g.cell = cell;
      if (grid) el("path", { d: hexagon(at[0], at[1], r * 0.985), fill: fill }, g);
      else el("circle", { cx: at[0], cy: at[1], r: 15, fill: fill, "class": "point" }, g);
      var ink = v !== null && scale(v) > 0.55 ? "#111" : v === null ? css("--ink") : "#fff";
      el("text", { x: at[0], y: at[1] + 4, style: "fill:" + ink + (grid ? "" : ";font-size:10px") }, g, text(cell));
      if (thesis(cell)) el("circle", { cx: at[0], cy: at[1], r: grid ? r * 0.62 : 18, "class": "ring", style: grid ? "stroke:" + ink : "" }, g);
      g.addEventListener("click", function () { choose(cell, true); });
    });
    var words = [[200, -20, "softmax", "middle"], [-6, 382, "argmax", "start"], [406, 382, "uniform", "end"]];
    words.forEach(function (w) { el("text", { x: w[0], y: w[1], "text-anchor": w[3], "class": "corner" }, map, w[2]); });
    if (cells.some(function (c) { return c.decays; })) el("text", { x: 262, y: 410, "text-anchor": "middle" }, map, "decaying \u03b5-greedy");
    if (cells.some(function (c) { return same(c.w, [0.7, 0, 0.3]); })) el("text", { x: 132, y: 410, "text-anchor": "middle" }, map, "\u03b5-greedy, \u03b5 = 0.3");
    var cap = data.tasks[state.task].cap;
    $("low").textContent = state.colour === "rate" ? "0 %" : cap + " iterations";
    $("high").textContent = state.colour === "rate" ? "100 %" : "0";
    $("bar").style.background = "linear-gradient(90deg," + VIRIDIS.join(",") + ")";
    $("what").textContent = (state.colour === "rate" ? "Share of the agents that " + state.measure + " within " + cap + " iterations" :
      "Mean iterations until an agent " + state.measure + ", at most " + cap) + "; grey: not run. Arrow keys move from cell to cell.";
    drawCell(now);
    drawTable(cells);
  }
  function choose(cell, focus) {
    state.w = cell.w;
    state.decays = cell.decays;
    drawMap();
    if (focus) map.querySelector(".chosen").focus();
  }
  map.addEventListener("keydown", function (event) {
    var way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!way) return;
    event.preventDefault();
    var cells = shown(), from = place(chosen(cells)), best = null, least = Infinity;
    cells.forEach(function (cell) {
      var at = place(cell), dx = at[0] - from[0], dy = at[1] - from[1];
      var along = dx * way[0] + dy * way[1], aside = Math.abs(dx * way[1]) + Math.abs(dy * way[0]);
      if (along > 1 && along + 2 * aside < least && aside <= 2 * along) { least = along + 2 * aside; best = cell; }
    });
    if (best) choose(best, true);
  });

  function row(body, name, content) {
    var tr = body.insertRow(), th = document.createElement("th");
    th.scope = "row";
    th.textContent = name;
    tr.appendChild(th);
    tr.insertCell().textContent = content;
  }
  function drawCell(cell) {
    var task = data.tasks[cell.task], own = cell[state.measure];
    $("title").textContent = label(cell);
    var body = $("numbers").tBodies[0];
    body.textContent = "";
    row(body, "passed", interval(cell.passed.rate, exact));
    row(body, "learned", interval(cell.learned.rate, exact));
    row(body, "iterations until they " + (state.measure === "passed" ? "passed" : "had learned"), interval(own.mean, number));
    row(body, "final score while exploring", interval(cell.score, number));
    row(body, "final score of the policy alone", interval(cell.learned_score, number));
    row(body, "agents", cell.n);
    document.querySelector(".event").textContent = state.measure;
    drawSurvival(own.survival, task);
    drawCurve(cell.curve, task);
    startFilm(cell, task);
  }
  function axes(svg, xMax, low, high, ticks) {
    svg.textContent = "";
    function x(v) { return 44 + v / xMax * 346; }
    function y(v) { return 160 - (v - low) / (high - low) * 146; }
    ticks.forEach(function (t) {
      el("line", { x1: 44, x2: 390, y1: y(t[0]), y2: y(t[0]), "class": "grid" }, svg);
      el("text", { x: 38, y: y(t[0]) + 4, "text-anchor": "end" }, svg, t[1]);
    });
    [0, xMax / 3, 2 * xMax / 3, xMax].forEach(function (v) { el("text", { x: x(v), y: 178, "text-anchor": v === xMax ? "end" : "middle" }, svg, Math.round(v)); });
    el("line", { x1: 44, x2: 390, y1: 160, y2: 160, "class": "axis" }, svg);
    return { x: x, y: y };
  }
  function steps(at, xs, ys) {
    return xs.map(function (t, i) {
      return (i ? "H" + at.x(t).toFixed(1) + "V" : "M" + at.x(t).toFixed(1) + " ") + at.y(ys[i]).toFixed(1);
    }).join("");
  }
  function points(at, xs, ys) {
    return xs.map(function (t, i) { return (i ? "L" : "M") + at.x(t).toFixed(1) + " " + at.y(ys[i]).toFixed(1); }).join("");
  }
  function back(at, xs, ys, stepped) {  // the same line from its end to its start
    var path = "";
    for (var i = xs.length - 1; i >= 0; i--) {
      if (stepped && i < xs.length - 1) path += "H" + at.x(xs[i + 1]).toFixed(1);
      path += (stepped ? "V" + at.y(ys[i]).toFixed(1) + "H" + at.x(xs[i]).toFixed(1) : "L" + at.x(xs[i]).toFixed(1) + " " + at.y(ys[i]).toFixed(1));
    }
    return path + "Z";
  }
  function drawSurvival(curve, task) {
    var svg = $("survival"), at = axes(svg, task.cap, 0, 1, [[0, "0"], [0.5, "50 %"], [1, "100 %"]]);
    if (!curve) { el("text", { x: 217, y: 90, "text-anchor": "middle" }, svg, "cannot be told: training stopped first"); return; }
    el("path", { d: steps(at, curve[0], curve[3]) + back(at, curve[0], curve[2], true), "class": "band" }, svg);
    el("path", { d: steps(at, curve[0], curve[1]), "class": "line" }, svg);
    svg.setAttribute("aria-label", "Survival curve: " + percent(curve[1][curve[1].length - 1]) + " of the agents have not " + state.measure + " after " + task.cap + " iterations");
  }
  function drawCurve(curve, task) {
    var all = curve[2].concat(curve[3], curve[4], [task.threshold]).filter(function (v) { return v !== null; });
    var low = Math.min.apply(null, all), high = Math.max.apply(null, all);
    if (low > 0) low = 0;
    high += 0.05 * (high - low || 1);
    var svg = $("curve"), at = axes(svg, task.cap, low, high, [[low, number(low)], [task.threshold, number(task.threshold)]]);
    el("text", { x: 390, y: at.y(task.threshold) - 4, "text-anchor": "end" }, svg, "threshold");
    el("path", { d: points(at, curve[0], curve[3]) + back(at, curve[0], curve[2], false), "class": "band" }, svg);
    el("path", { d: points(at, curve[0], curve[1]), "class": "line" }, svg);
    el("path", { d: points(at, curve[0], curve[4]), "class": "line second" }, svg);
    svg.setAttribute("aria-label", "Learning curve: the policy alone scores " + number(curve[1][curve[1].length - 1]) + " in the end, " + number(curve[4][curve[4].length - 1]) + " while exploring");
  }
  function drawTable(cells) {
    var body = document.querySelector("#all tbody"), task = data.tasks[state.task];
    $("about").textContent = (NAMES[task.id] || task.id) + ", " + (state.corrected ? "per-step ratio" : "uncorrected") + ", T = " + state.T;
    body.textContent = "";
    cells.forEach(function (cell) {
      var tr = body.insertRow();
      cell.w.map(function (w) { return cell.decays ? "" : percent(w); }).concat([
        thesis(cell), interval(cell.passed.rate, exact), interval(cell.learned.rate, exact),
        interval(cell.passed.mean, number), interval(cell.learned.mean, number)
      ]).forEach(function (content) { tr.insertCell().textContent = content; });
    });
  }

  // The film: the recorded states, drawn one after the other.
  var film = { frame: 0, timer: null, cell: null, task: null };
  var screen = $("screen"), pen = screen.getContext("2d");
  var still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  var playing = !still;
  function startFilm(cell, task) {
    $("film").hidden = !cell.film;
    clearTimeout(film.timer);
    if (!cell.film) return;
    film = { frame: 0, timer: null, cell: cell, task: task };
    screen.setAttribute("aria-label", "Film of the agent of trial " + cell.film.trial + ": score " + number(cell.film.score) + " in " + cell.film.steps + " steps, " + cell.film.exploratory.length + " exploratory actions");
    tick();
  }
  function tick() {
    clearTimeout(film.timer);
    drawFilm();
    $("play").textContent = playing ? "Pause" : "Play";
    if (!playing) return;
    var last = film.frame >= film.cell.film.states[0].length - 1;
    var pause = last ? 1500 : film.task.kind === "cartpole" ? 33 : 350;
    film.timer = setTimeout(function () { film.frame = last ? 0 : film.frame + 1; tick(); }, pause);
  }
  $("play").addEventListener("click", function () { playing = !playing; tick(); });
  function drawFilm() {
    var own = film.cell.film, f = film.frame, shownSteps = own.states[0].length - 1;
    var explores = f > 0 && own.exploratory.indexOf(f - 1) >= 0;
    var score = own.rewards.length ? own.rewards.slice(0, f).reduce(function (a, b) { return a + b; }, 0) : f;
    var ended = f >= shownSteps && shownSteps === own.steps;
    pen.fillStyle = css("--paper");
    pen.fillRect(0, 0, 640, 400);
    ({ cartpole: drawCart, grid: drawGrid, "catch": drawCatch })[film.task.kind](own.states.map(function (c) { return c[f]; }));
    pen.strokeStyle = css("--mark");
    pen.lineWidth = 10;
    if (explores) pen.strokeRect(0, 0, 640, 400);
    own.exploratory.forEach(function (t) {
      if (t >= f) return;
      pen.fillStyle = css("--mark");
      pen.fillRect(640 * t / own.steps, 388, Math.max(2, 640 / own.steps - 1), 12);
    });
    $("caption").textContent = "trial " + own.trial + ", step " + f + ", score " + number(score).replace(/\.00$|\.0$/, "") +
      (ended ? (own.terminated ? ": ended" : ": time is up") : f >= shownSteps ? ": it goes on to " + own.steps + " steps" : explores ? ": exploratory action" : "");
  }
  function drawCart(s) {
    var x = 320 + s[0] / 1000 / 2.4 * 300, angle = s[1] / 1000;
    pen.strokeStyle = css("--muted"); pen.lineWidth = 2;
    pen.beginPath(); pen.moveTo(0, 300); pen.lineTo(640, 300); pen.stroke();
    pen.fillStyle = css("--ink"); pen.fillRect(x - 35, 285, 70, 34);
    pen.strokeStyle = css("--link"); pen.lineWidth = 12; pen.lineCap = "round";
    pen.beginPath(); pen.moveTo(x, 288); pen.lineTo(x + 200 * Math.sin(angle), 288 - 200 * Math.cos(angle)); pen.stroke();
  }
  function drawGrid(s) {
    var rows = film.task.rows, n = rows.length, size = 360 / n, left = 320 - rows[0].length * size / 2;
    rows.forEach(function (line, i) {
      line.split("").forEach(function (c, j) {
        pen.fillStyle = c === "H" ? "#2c728e" : c === "G" ? "#5ec962" : css("--soft");
        pen.fillRect(left + j * size, 10 + i * size, size - 3, size - 3);
        pen.fillStyle = c === "F" ? css("--muted") : c === "S" ? css("--ink") : "#fff"; pen.font = "16px sans-serif"; pen.textAlign = "center";
        if (c !== "F") pen.fillText({ S: "start", G: "goal", H: "hole" }[c], left + (j + 0.5) * size, 10 + i * size + 20);
      });
    });
    var width = rows[0].length;
    disc(left + (s[0] % width + 0.5) * size, 10 + (Math.floor(s[0] / width) + 0.6) * size, size * 0.22, css("--ink"));
  }
  function drawCatch(s) {
    var size = 370 / film.task.rows, left = 320 - film.task.columns * size / 2;
    for (var i = 0; i < film.task.rows; i++) for (var j = 0; j < film.task.columns; j++) {
      pen.fillStyle = css("--soft"); pen.fillRect(left + j * size, 8 + i * size, size - 3, size - 3);
    }
    pen.fillStyle = css("--ink"); pen.fillRect(left + s[2] * size + 3, 8 + (film.task.rows - 0.55) * size, size - 9, size * 0.3);
    disc(left + (s[1] + 0.47) * size, 8 + (s[0] + 0.4) * size, size * 0.28, css("--link"));
  }
  function disc(x, y, r, fill) { pen.fillStyle = fill; pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.fill(); }

  // The choices.
  function radios(parent, name, entries, now) {
    entries.forEach(function (entry) {
      var made = document.createElement("label"), input = document.createElement("input");
      input.type = "radio"; input.name = name; input.value = entry[0]; input.checked = entry[0] === now;
      made.appendChild(input);
      made.appendChild(document.createTextNode(" " + entry[1]));
      parent.appendChild(made);
    });
  }
  radios($("task"), "task", data.tasks.map(function (t, i) { return [i, NAMES[t.id] || t.id]; }), 0);
  var temperatures = data.cells.map(function (c) { return c.T; }).filter(function (t, i, all) { return all.indexOf(t) === i; }).sort(function (a, b) { return a - b; });
  if (temperatures.indexOf(1) < 0) state.T = temperatures[0];
  radios($("temperature"), "T", temperatures.map(function (t) { return [t, "T = " + t]; }), state.T);
  $("choices").addEventListener("change", function (event) {
    var name = event.target.name, v = event.target.value;
    state[name] = name === "measure" || name === "colour" ? v : Number(v);
    drawMap();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawMap);
  state.w = [0, 1, 0];
  drawMap();
})();
