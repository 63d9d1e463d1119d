"use strict";
// Zoom, readout and choice of curves in figures. Without this script all curves are shown.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const REACH = 30; // pixels of the figure: largest distance of the pointer from a curve
  const TICKS = 7; // largest number of intervals between labels
  const MANTISSAS = [[1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9]]; // of a logarithmic axis
  const DEEPEST = 60; // largest magnification

  function roundStep(size) {
    const power = 10 ** Math.floor(Math.log10(size));
    for (const digit of [1, 2, 5]) if (size <= digit * power * 1.0000001) return digit * power;
    return 10 * power;
  }

  function formatFixed(value, step) {
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return (value + 0).toFixed(Math.min(decimals, 12)).replace("-", "\u2212");
  }

  function evenTicks(low, high) {
    const step = roundStep((high - low) / TICKS), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k <= Math.floor(high / step + 1e-9); k++) {
      found.push([k * step, formatFixed(k * step, step)]);
    }
    return found;
  }

  function power(mantissa, k) {
    if (k >= 0 && k < 6) return String(mantissa * 10 ** k);
    if (k >= -4 && k < 0) return (mantissa * 10 ** k).toFixed(-k);
    return `${mantissa}e${k}`.replace("-", "\u2212");
  }

  // low and high are log10 of the labelled numbers.
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

  // Return one array of x, y for each M of a path "Mx,yldx,dy ...".
  function strokes(path) {
    return path.split("M").slice(1).map((part) => {
      const numbers = (part.match(/-?\d+/g) || []).map(Number);
      for (let k = 2; k < numbers.length; k++) numbers[k] += numbers[k - 2];
      return numbers;
    });
  }

  const links = []; // linked figures highlight the time interval that another figure shows
  const NEAR = 0.004; // of a recording: half the highlighted interval at the pointer

  function save(name, kind, content) {
    const made = document.createElement("a");
    made.href = URL.createObjectURL(new Blob([content], { type: kind }));
    made.download = name;
    made.click();
    setTimeout(() => URL.revokeObjectURL(made.href), 10000);
  }

  // Return a figure as a separate SVG file, with the styles of the page as attributes.
  const DRAWN = ["fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray", "stroke-linecap",
    "stroke-linejoin", "font-size", "font-family", "display", "vector-effect"];
  function standaloneSvg(frame) {
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
    let viewport = { ...full };
    let curvePoints = null;
    const curves = () => (curvePoints = curvePoints || layers.map((layer) => strokes(layer.getAttribute("d"))));

    const valueX = (x) => ends.x[0] + (ends.x[1] - ends.x[0]) * x / full.w;
    const valueY = (y) => ends.y[1] - (ends.y[1] - ends.y[0]) * y / full.h;
    const pageX = (x) => left + (x - viewport.x) / viewport.w * width;
    const pageY = (y) => top + (y - viewport.y) / viewport.h * height;

    function ticks(name, low, high, place) {
      const group = figure.querySelector(`.ticks-${name}`);
      group.replaceChildren();
      const made = (data.decades.includes(name) ? decadeTicks : evenTicks)(low, high);
      for (const [value, label] of made) place(group, value, label);
    }

    // Format a value at the pointer to a thousandth of the visible range.
    function formatValue(name, value, seenLow, seenHigh) {
      if (data.decades.includes(name)) return String(Number((10 ** value).toPrecision(3)));
      return formatFixed(value, roundStep((seenHigh - seenLow) / 1000));
    }

    function show(next) {
      const w = Math.min(full.w, Math.max(full.w / DEEPEST, next.w));
      const h = full.h * w / full.w;
      viewport = {
        x: Math.min(full.w - w, Math.max(0, next.x)),
        y: Math.min(full.h - h, Math.max(0, next.y)), w, h,
      };
      plot.setAttribute("viewBox", `${viewport.x} ${viewport.y} ${viewport.w} ${viewport.h}`);
      view.classList.toggle("near", viewport.w < full.w);
      ticks("x", valueX(viewport.x), valueX(viewport.x + viewport.w),
        (group, value, label) => {
          const at = pageX((value - ends.x[0]) / (ends.x[1] - ends.x[0]) * full.w).toFixed(1);
          group.append(element("path", { class: "grid", d: `M${at},${top}v${height}` }),
            element("text", { class: "tick", x: at, y: top + height + 18, "text-anchor": "middle" }, label));
        });
      ticks("y", valueY(viewport.y + viewport.h), valueY(viewport.y),
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

    // Points of the curve with times, by stroke; times are fractions of the recording.
    let timedPoints = null;
    function timed() {
      if (timedPoints) return timedPoints;
      const index = layers.findIndex((layer) => layer.dataset.times);
      const times = index < 0 ? [] : layers[index].dataset.times.split(" ").map((time) => time / 1e4);
      let k = 0;
      timedPoints = (curves()[index] || []).map((points) => {
        const stroke = [];
        for (let i = 0; i + 1 < points.length; i += 2) stroke.push({ x: points[i], y: points[i + 1], time: times[k++] });
        return stroke;
      });
      return timedPoints;
    }

    // Time intervals that a magnified figure shows; empty for the full view.
    function inView() {
      if (viewport.w >= full.w) return [];
      if (span) return [[valueX(viewport.x) / span, valueX(viewport.x + viewport.w) / span]];
      const found = [];
      for (const stroke of timed()) {
        let open = null;
        for (const { x, y, time } of stroke) {
          const inside = x >= viewport.x && x <= viewport.x + viewport.w && y >= viewport.y && y <= viewport.y + viewport.h;
          if (inside && open) open[1] = time;
          else if (inside) found.push(open = [time, time]);
          else open = null;
        }
      }
      return found;
    }

    // Highlight time intervals: bars behind a curve over time, or parts of a curve with times.
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

    // Time of a point of the figure, as a fraction of the recording.
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
      show({ x: x - (x - viewport.x) * factor, y: y - (y - viewport.y) * factor, w: viewport.w * factor });
    }

    // Position of the pointer, in fine steps of the plot.
    function pointed(event) {
      const box = frame.getBoundingClientRect();
      const pixels = frame.viewBox.baseVal.width / box.width;
      return {
        x: viewport.x + ((event.clientX - box.left) * pixels - left) / width * viewport.w,
        y: viewport.y + ((event.clientY - box.top) * pixels - top) / height * viewport.h,
      };
    }

    function nearest(x, y) {
      const scale = width / viewport.w;
      let best = { distance: REACH };
      layers.forEach((layer, index) => {
        if (layer.classList.contains("off") || /limit|band|zero/.test(layer.dataset.role)) return;
        for (const points of curves()[index]) {
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
      const x = formatValue("x", valueX(best.x), valueX(viewport.x), valueX(viewport.x + viewport.w));
      const y = formatValue("y", valueY(best.y), valueY(viewport.y + viewport.h), valueY(viewport.y));
      readout.textContent =
        `${best.name}: ${data.xName} ${x} ${data.xUnit}, ${data.yName} ${y} ${data.yUnit}`;
      const time = figure.dataset.link && timeOf(best.x, best.y);
      if (!Number.isFinite(time)) return;
      for (const other of linked()) {
        other.light([[time - NEAR, time + NEAR]]);
        const lasts = Number(other.figure.dataset.span);
        if (lasts) readout.textContent += `, time ${formatFixed(time * lasts, roundStep(lasts / 1000))} s`;
      }
    }

    let grip = null;
    view.addEventListener("pointerdown", (event) => {
      if (viewport.w < full.w) { grip = pointed(event); view.setPointerCapture(event.pointerId); }
    });
    view.addEventListener("pointermove", (event) => {
      if (!grip) { read(event); return; }
      const at = pointed(event);
      show({ x: viewport.x + grip.x - at.x, y: viewport.y + grip.y - at.y, w: viewport.w });
    });
    for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, () => { grip = null; });
    view.addEventListener("pointerleave", leave);
    // The wheel scrolls the page until the figure is clicked.
    view.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== view) return;
      event.preventDefault();
      const at = pointed(event);
      zoom(event.deltaY > 0 ? 1.25 : 0.8, at.x, at.y);
    }, { passive: false });
    view.addEventListener("dblclick", () => show(full));
    const middle = (factor) => zoom(factor, viewport.x + viewport.w / 2, viewport.y + viewport.h / 2);
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    view.addEventListener("keydown", (event) => {
      if (event.key === "+" || event.key === "=") middle(0.8);
      else if (event.key === "-") middle(1.25);
      else if (event.key === "0") show(full);
      else if (event.key in moves && viewport.w < full.w) {
        const [dx, dy] = moves[event.key];
        show({ x: viewport.x + dx * viewport.w / 10, y: viewport.y + dy * viewport.h / 10, w: viewport.w });
      } else return;
      event.preventDefault();
    });
    figure.querySelector(".reset").addEventListener("click", () => show(full));

    // Numbers of every curve as CSV, resolved to a twentieth of a pixel of the full view.
    function numbers() {
      const head = (name, unit) => quoted(unit ? `${name} [${unit}]` : name);
      const shown = (name, value) => (data.decades.includes(name) ? 10 ** value : value).toPrecision(6);
      const rows = [`${quoted("curve")},${head(data.xName, data.xUnit)},${head(data.yName, data.yUnit)}`];
      layers.forEach((layer, index) => {
        for (const points of curves()[index]) {
          for (let k = 0; k + 1 < points.length; k += 2) {
            rows.push(`${quoted(layer.dataset.name)},${shown("x", valueX(points[k]))},${shown("y", valueY(points[k + 1]))}`);
          }
        }
      });
      return rows.join("\r\n") + "\r\n";
    }
    for (const button of figure.querySelectorAll(".save")) {
      button.addEventListener("click", () => {
        if (button.dataset.as === "svg") save(`${figure.id}.svg`, "image/svg+xml", standaloneSvg(frame));
        else save(`${figure.id}.csv`, "text/csv", numbers());
      });
    }

    keys.forEach((key, index) => key.addEventListener("click", () => {
      key.setAttribute("aria-pressed", String(!layers[index].classList.toggle("off")));
    }));
  }

  document.querySelectorAll("figure.chart").forEach(activate);
})();
