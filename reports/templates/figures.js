"use strict";
// Figures that can be magnified, read and flickered. Without this script all curves are shown.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const REACH = 30; // pixels of the figure: a pointer farther from a curve reads nothing
  const TICKS = 7; // the most intervals between labels
  const MANTISSAS = [[1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9]]; // of a logarithmic axis
  const DEEPEST = 60; // times the full view

  function roundStep(size) {
    const power = 10 ** Math.floor(Math.log10(size));
    for (const digit of [1, 2, 5]) if (size <= digit * power * 1.0000001) return digit * power;
    return 10 * power;
  }

  function written(value, step) {
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return (value + 0).toFixed(Math.min(decimals, 12)).replace("-", "\u2212");
  }

  function evenTicks(low, high) {
    const step = roundStep((high - low) / TICKS), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k <= Math.floor(high / step + 1e-9); k++) {
      found.push([k * step, written(k * step, step)]);
    }
    return found;
  }

  function power(mantissa, k) {
    if (k >= 0 && k < 6) return String(mantissa * 10 ** k);
    if (k >= -4 && k < 0) return (mantissa * 10 ** k).toFixed(-k);
    return `${mantissa}e${k}`.replace("-", "\u2212");
  }

  // The ends are log10 of what is shown.
  function decadeTicks(low, high) {
    for (const mantissas of MANTISSAS) {
      const found = [];
      for (let k = Math.floor(low); k <= Math.ceil(high); k++) {
        for (const m of mantissas) {
          const at = k + Math.log10(m);
          if (low - 1e-9 <= at && at <= high + 1e-9) found.push([at, power(m, k), k]);
        }
      }
      const apart = mantissas.length > 1 ? 1 : Math.ceil(found.length / TICKS);
      if (found.length >= 3) return found.filter((tick) => tick[2] % apart === 0);
    }
    return evenTicks(10 ** low, 10 ** high).filter((tick) => tick[0] > 0)
      .map(([value, label]) => [Math.log10(value), label]);
  }

  function element(name, attributes, text) {
    const made = document.createElementNS(SVG, name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  // A path of ours: M x,y l dx,dy ... ; returns one array of x, y for each M.
  function strokes(path) {
    return path.split("M").slice(1).map((part) => {
      const numbers = (part.match(/-?\d+/g) || []).map(Number);
      for (let k = 2; k < numbers.length; k++) numbers[k] += numbers[k - 2];
      return numbers;
    });
  }

  const links = []; // figures of one record: the stretches of time the one shows are lit in the other
  const NEAR = 0.004; // of a record: the stretch about the pointer

  function save(name, kind, content) {
    const made = document.createElement("a");
    made.href = URL.createObjectURL(new Blob([content], { type: kind }));
    made.download = name;
    made.click();
    setTimeout(() => URL.revokeObjectURL(made.href), 10000);
  }

  // The drawing alone: every rule that the page's style gives it is written into it.
  const DRAWN = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap",
    "stroke-linejoin", "font-size", "font-family", "display", "vector-effect"];
  function standing(frame) {
    const copy = frame.cloneNode(true);
    const from = frame.querySelectorAll("*"), to = copy.querySelectorAll("*");
    from.forEach((one, k) => {
      const style = getComputedStyle(one);
      for (const name of DRAWN) {
        const value = style.getPropertyValue(name);
        if (value && value !== "none" || name === "fill" || name === "display") to[k].setAttribute(name, value);
      }
    });
    copy.setAttribute("xmlns", SVG);
    return new XMLSerializer().serializeToString(copy);
  }

  function quoted(text) { return `"${String(text).replaceAll('"', '""')}"`; }

  function activate(figure) {
    const view = figure.querySelector(".view");
    const frame = figure.querySelector(".frame");
    const plot = figure.querySelector(".plot");
    const here = figure.querySelector(".here");
    const cross = figure.querySelector(".cross");
    const readout = figure.querySelector(".readout");
    const layers = [...figure.querySelectorAll(".layer")];
    const keys = [...figure.querySelectorAll(".key")];
    const data = frame.dataset;
    const [left, top, width, height, fine] =
      [data.left, data.top, data.width, data.height, data.fine].map(Number);
    const ends = { x: data.x.split(" ").map(Number), y: data.y.split(" ").map(Number) };
    const full = { x: 0, y: 0, w: width * fine, h: height * fine };
    const lit = figure.querySelector(".lit");
    const span = Number(figure.dataset.span || 0);
    if (figure.dataset.link) links.push({ name: figure.dataset.link, figure, light: (stretches) => light(stretches) });
    let seen = { ...full };
    let drawn = null;

    const valueX = (x) => ends.x[0] + (ends.x[1] - ends.x[0]) * x / full.w;
    const valueY = (y) => ends.y[1] - (ends.y[1] - ends.y[0]) * y / full.h;
    const pageX = (x) => left + (x - seen.x) / seen.w * width;
    const pageY = (y) => top + (y - seen.y) / seen.h * height;

    function ticks(name, low, high, place) {
      const group = figure.querySelector(`.ticks-${name}`);
      group.replaceChildren();
      const made = (data.decades.includes(name) ? decadeTicks : evenTicks)(low, high);
      for (const [value, label] of made) place(group, value, label);
    }

    // A value under the pointer, to a thousandth of what is seen.
    function told(name, value, seenLow, seenHigh) {
      if (data.decades.includes(name)) return String(Number((10 ** value).toPrecision(3)));
      return written(value, roundStep((seenHigh - seenLow) / 1000));
    }

    function show(next) {
      const w = Math.min(full.w, Math.max(full.w / DEEPEST, next.w));
      const h = full.h * w / full.w;
      seen = {
        x: Math.min(full.w - w, Math.max(0, next.x)),
        y: Math.min(full.h - h, Math.max(0, next.y)), w, h,
      };
      plot.setAttribute("viewBox", `${seen.x} ${seen.y} ${seen.w} ${seen.h}`);
      view.classList.toggle("near", seen.w < full.w);
      ticks("x", valueX(seen.x), valueX(seen.x + seen.w),
        (group, value, label) => {
          const at = pageX((value - ends.x[0]) / (ends.x[1] - ends.x[0]) * full.w).toFixed(1);
          group.append(element("path", { class: "grid", d: `M${at},${top}v${height}` }),
            element("text", { class: "tick", x: at, y: top + height + 18, "text-anchor": "middle" }, label));
        });
      ticks("y", valueY(seen.y + seen.h), valueY(seen.y),
        (group, value, label) => {
          const at = pageY((ends.y[1] - value) / (ends.y[1] - ends.y[0]) * full.h);
          group.append(element("path", { class: "grid", d: `M${left},${at.toFixed(1)}h${width}` }),
            element("text", { class: "tick", x: left - 7, y: (at + 4).toFixed(1), "text-anchor": "end" }, label));
        });
      leave();
    }

    function leave() {
      for (const one of [here, cross]) one.setAttribute("visibility", "hidden");
      readout.textContent = "";
      figure.classList.remove("read");
      linked().forEach((other) => other.light(inView()));
    }

    function linked() {
      return links.filter((other) => other.name === figure.dataset.link && other.figure !== figure);
    }

    // The points of the curve that knows when each was, in strokes; times are shares of the record.
    let known = null;
    function timed() {
      if (known) return known;
      drawn = drawn || layers.map((layer) => strokes(layer.getAttribute("d")));
      const index = layers.findIndex((layer) => layer.dataset.times);
      const times = index < 0 ? [] : layers[index].dataset.times.split(" ").map((time) => time / 1e4);
      let k = 0;
      known = (drawn[index] || []).map((points) => {
        const stroke = [];
        for (let i = 0; i + 1 < points.length; i += 2) stroke.push({ x: points[i], y: points[i + 1], time: times[k++] });
        return stroke;
      });
      return known;
    }

    // The stretches of the record that a magnified figure shows; of the whole, none.
    function inView() {
      if (seen.w >= full.w) return [];
      if (span) return [[valueX(seen.x) / span, valueX(seen.x + seen.w) / span]];
      const found = [];
      for (const stroke of timed()) {
        let open = null;
        for (const { x, y, time } of stroke) {
          const inside = x >= seen.x && x <= seen.x + seen.w && y >= seen.y && y <= seen.y + seen.h;
          if (inside && open) open[1] = time;
          else if (inside) found.push(open = [time, time]);
          else open = null;
        }
      }
      return found;
    }

    // Light stretches of the record: bars behind a course in time, parts of a curve that knows its times.
    function light(stretches) {
      let path = "";
      if (span) {
        const at = (share) => ((share * span - ends.x[0]) / (ends.x[1] - ends.x[0]) * full.w).toFixed(0);
        for (const [low, high] of stretches) path += `M${at(low)},0V${full.h}H${at(high)}V0Z`;
      } else {
        for (const stroke of timed()) {
          let pen = "M";
          for (const { x, y, time } of stroke) {
            const inside = stretches.some(([low, high]) => time >= low && time <= high);
            if (inside) path += `${pen}${x},${y}`;
            pen = inside ? "L" : "M";
          }
        }
      }
      lit.setAttribute("d", path);
    }

    // When a point of the figure was, as a share of the record.
    function timeOf(x, y) {
      if (span) return valueX(x) / span;
      let best = { distance: Infinity };
      for (const stroke of timed()) {
        for (const point of stroke) {
          const distance = Math.hypot(point.x - x, point.y - y);
          if (distance < best.distance) best = { distance, time: point.time };
        }
      }
      return best.time;
    }

    function zoom(factor, x, y) {
      show({ x: x - (x - seen.x) * factor, y: y - (y - seen.y) * factor, w: seen.w * factor });
    }

    // Where the pointer is, in fine steps of the plot.
    function pointed(event) {
      const box = frame.getBoundingClientRect();
      const pixels = frame.viewBox.baseVal.width / box.width;
      return {
        x: seen.x + ((event.clientX - box.left) * pixels - left) / width * seen.w,
        y: seen.y + ((event.clientY - box.top) * pixels - top) / height * seen.h,
      };
    }

    function nearest(x, y) {
      drawn = drawn || layers.map((layer) => strokes(layer.getAttribute("d")));
      const scale = width / seen.w;
      let best = { distance: REACH };
      layers.forEach((layer, index) => {
        if (layer.classList.contains("off") || /limit|band|zero/.test(layer.dataset.role)) return;
        for (const points of drawn[index]) {
          for (let k = 2; k + 1 < points.length; k += 2) {
            const ax = points[k - 2], ay = points[k - 1];
            const dx = points[k] - ax, dy = points[k + 1] - ay;
            const length = dx * dx + dy * dy;
            const t = length ? Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
            const px = ax + t * dx, py = ay + t * dy;
            const distance = Math.hypot(px - x, py - y) * scale;
            if (distance < best.distance) best = { distance, x: px, y: py, name: layer.dataset.name };
          }
        }
      });
      return best;
    }

    function read(event) {
      const at = pointed(event);
      const best = nearest(at.x, at.y);
      if (!best.name) { leave(); return; }
      for (const one of [here, cross]) one.setAttribute("visibility", "visible");
      figure.classList.add("read");
      const cx = pageX(best.x).toFixed(1), cy = pageY(best.y).toFixed(1);
      here.setAttribute("cx", cx);
      here.setAttribute("cy", cy);
      cross.setAttribute("d", `M${cx},${top}v${height}M${left},${cy}h${width}`);
      const x = told("x", valueX(best.x), valueX(seen.x), valueX(seen.x + seen.w));
      const y = told("y", valueY(best.y), valueY(seen.y + seen.h), valueY(seen.y));
      readout.textContent =
        `${best.name}: ${data.xName} ${x} ${data.xUnit}, ${data.yName} ${y} ${data.yUnit}`;
      const time = figure.dataset.link && timeOf(best.x, best.y);
      if (!Number.isFinite(time)) return;
      for (const other of linked()) {
        other.light([[time - NEAR, time + NEAR]]);
        const lasts = Number(other.figure.dataset.span);
        if (lasts) readout.textContent += `, time ${written(time * lasts, roundStep(lasts / 1000))} s`;
      }
    }

    let grip = null;
    view.addEventListener("pointerdown", (event) => {
      if (seen.w < full.w) { grip = pointed(event); view.setPointerCapture(event.pointerId); }
    });
    view.addEventListener("pointermove", (event) => {
      if (!grip) { read(event); return; }
      const at = pointed(event);
      show({ x: seen.x + grip.x - at.x, y: seen.y + grip.y - at.y, w: seen.w });
    });
    for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, () => { grip = null; });
    view.addEventListener("pointerleave", leave);
    // The wheel belongs to the page until the figure was clicked.
    view.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== view) return;
      event.preventDefault();
      const at = pointed(event);
      zoom(event.deltaY > 0 ? 1.25 : 0.8, at.x, at.y);
    }, { passive: false });
    view.addEventListener("dblclick", () => show(full));
    const middle = (factor) => zoom(factor, seen.x + seen.w / 2, seen.y + seen.h / 2);
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    view.addEventListener("keydown", (event) => {
      if (event.key === "+" || event.key === "=") middle(0.8);
      else if (event.key === "-") middle(1.25);
      else if (event.key === "0") show(full);
      else if (event.key in moves && seen.w < full.w) {
        const [dx, dy] = moves[event.key];
        show({ x: seen.x + dx * seen.w / 10, y: seen.y + dy * seen.h / 10, w: seen.w });
      } else return;
      event.preventDefault();
    });
    figure.querySelector(".reset").addEventListener("click", () => show(full));

    // The numbers of every curve as they are drawn: to a twentieth of a pixel of the full view.
    function numbers() {
      drawn = drawn || layers.map((layer) => strokes(layer.getAttribute("d")));
      const head = (name, unit) => quoted(unit ? `${name} [${unit}]` : name);
      const shown = (name, value) => (data.decades.includes(name) ? 10 ** value : value).toPrecision(6);
      const rows = [`${quoted("curve")},${head(data.xName, data.xUnit)},${head(data.yName, data.yUnit)}`];
      layers.forEach((layer, index) => {
        for (const points of drawn[index]) {
          for (let k = 0; k + 1 < points.length; k += 2) {
            rows.push(`${quoted(layer.dataset.name)},${shown("x", valueX(points[k]))},${shown("y", valueY(points[k + 1]))}`);
          }
        }
      });
      return rows.join("\r\n") + "\r\n";
    }
    for (const button of figure.querySelectorAll(".save")) {
      button.addEventListener("click", () => {
        if (button.dataset.as === "svg") save(`${figure.id}.svg`, "image/svg+xml", standing(frame));
        else save(`${figure.id}.csv`, "text/csv", numbers());
      });
    }

    function setShown(index, on) {
      layers[index].classList.toggle("off", !on);
      keys[index].setAttribute("aria-pressed", String(on));
    }
    keys.forEach((key, index) => key.addEventListener("click", () => {
      setShown(index, key.getAttribute("aria-pressed") !== "true");
    }));

    const flicker = figure.querySelector(".flicker");
    if (!flicker) return;
    const still = matchMedia("(prefers-reduced-motion: reduce)");
    const roles = flicker.dataset.roles.split(" ");
    let clock = 0, turn = 0;
    function next() {
      turn += 1;
      layers.forEach((layer, index) => {
        if (roles.includes(layer.dataset.role)) setShown(index, roles[turn % roles.length] === layer.dataset.role);
      });
    }
    flicker.addEventListener("click", () => {
      if (still.matches) { next(); return; }
      const on = !clock;
      flicker.setAttribute("aria-pressed", String(on));
      if (on) { next(); clock = setInterval(next, 800); return; }
      clearInterval(clock);
      clock = 0;
      layers.forEach((layer, index) => { if (roles.includes(layer.dataset.role)) setShown(index, true); });
    });
  }

  document.querySelectorAll("figure.chart").forEach(activate);
})();
