// Run in front of the page's own script: hears every error, then uses the page as a reader would,
// and writes what it found where --dump-dom shows it.
"use strict";
(() => {
  const errors = [];
  addEventListener("error", (event) => errors.push(String(event.message)));
  addEventListener("securitypolicyviolation", (event) => errors.push(`policy: ${event.blockedURI}`));
  const send = (target, kind, extra) => target.dispatchEvent(
    new (extra && "clientX" in extra ? PointerEvent : KeyboardEvent)(kind, { bubbles: true, cancelable: true, ...extra }));
  addEventListener("load", () => {
    // The first screen as it opens, before anything is unfolded.
    const sheet = document.documentElement.scrollHeight;
    const words = document.body.innerText.split(/\s+/).length;
    const rows = [...document.querySelectorAll(".card")].map((card) => card.getBoundingClientRect().bottom);
    const reached = [...document.querySelectorAll("summary, nav a, .view")].filter((one) => one.tabIndex === 0).length;
    const keys = document.querySelectorAll("summary, nav a, .view").length;
    const linked = document.querySelector("figure[data-span] .view"), lit = document.querySelector(".lit");
    send(linked, "keydown", { key: "+" });
    const litNear = lit.getAttribute("d");
    send(linked, "keydown", { key: "0" });
    const litAgain = lit.getAttribute("d");
    // The other way: over the loop, and with the loop magnified, the residual is lit where that was.
    const bars = document.querySelector("figure[data-span] .lit"), loop = lit.closest("figure");
    const timed = loop.querySelector("[data-times]");
    const there = timed.getPointAtLength(timed.getTotalLength() / 3).matrixTransform(timed.getScreenCTM());
    send(loop.querySelector(".view"), "pointermove", { clientX: there.x, clientY: there.y });
    const told = loop.querySelector(".readout").textContent, barOver = bars.getAttribute("d");
    const crossed = loop.querySelector(".cross").getBoundingClientRect();
    const crosshair = { visible: loop.querySelector(".cross").getAttribute("visibility"), width: crossed.width, height: crossed.height };
    loop.querySelector(".view").dispatchEvent(new PointerEvent("pointerleave"));
    const barLeft = bars.getAttribute("d");
    send(loop.querySelector(".view"), "keydown", { key: "+" });
    const barsNear = bars.getAttribute("d");
    send(loop.querySelector(".view"), "keydown", { key: "0" });
    const saved = [];
    const press = HTMLAnchorElement.prototype.click;
    const asked = URL.createObjectURL;
    URL.createObjectURL = (blob) => { saved.push({ kind: blob.type, size: blob.size }); return "#"; };
    HTMLAnchorElement.prototype.click = () => {};
    document.querySelectorAll("figure.chart .save").forEach((button) => { button.click(); });
    URL.createObjectURL = asked;
    HTMLAnchorElement.prototype.click = press;
    document.querySelectorAll("details").forEach((one) => { one.open = true; });
    const sizes = [...document.querySelectorAll("figure.chart")].map((figure) => {
      const frame = figure.querySelector(".frame").getBoundingClientRect();
      const curves = [...figure.querySelectorAll(".layer:not(.left-out):not(.missing)")].map((layer) => {
        const box = layer.getBoundingClientRect();
        return [box.width, box.height];
      });
      return { width: frame.width, height: frame.height, curves };
    });
    const figure = document.querySelector("#loops figure.chart");
    figure.scrollIntoView();
    const view = figure.querySelector(".view"), plot = figure.querySelector(".plot");
    const box = view.getBoundingClientRect();
    const ticksBefore = figure.querySelector(".ticks-x").textContent;
    const whole = plot.getAttribute("viewBox");
    // Over the middle of the first curve something must be read.
    const curve = figure.querySelector(".layer");
    const on = curve.getPointAtLength(curve.getTotalLength() / 2).matrixTransform(curve.getScreenCTM());
    send(view, "pointermove", { clientX: on.x, clientY: on.y });
    const readout = figure.querySelector(".readout").textContent;
    const ring = figure.querySelector(".here").getBoundingClientRect();
    const astray = Math.hypot(ring.x + ring.width / 2 - on.x, ring.y + ring.height / 2 - on.y);
    send(view, "keydown", { key: "+" });
    const near = plot.getAttribute("viewBox"), ticksNear = figure.querySelector(".ticks-x").textContent;
    view.dispatchEvent(new MouseEvent("dblclick", { bubbles: true }));
    const again = plot.getAttribute("viewBox"), ticksAgain = figure.querySelector(".ticks-x").textContent;
    const unfocused = new WheelEvent("wheel", { deltaY: -1, clientX: box.x + 200, clientY: box.y + 200, cancelable: true });
    view.dispatchEvent(unfocused);
    view.focus();
    const focused = new WheelEvent("wheel", { deltaY: -1, clientX: on.x, clientY: on.y, cancelable: true });
    view.dispatchEvent(focused);
    const byWheel = plot.getAttribute("viewBox");
    send(view, "keydown", { key: "0" });
    figure.querySelector(".key").click();
    const hidden = getComputedStyle(figure.querySelector(".layer")).display;
    figure.querySelector(".key").click();
    const after = [...figure.querySelectorAll(".layer.off")].length;
    // The script writes the ticks anew: they must be those that stood there.
    const ticksOf = (one) => [...one.querySelectorAll(".tick")].map((tick) => tick.textContent.trim()).join(" ");
    const rewritten = [...document.querySelectorAll("figure.chart")].map((one) => {
      const before = ticksOf(one);
      send(one.querySelector(".view"), "keydown", { key: "0" });
      return { decades: one.querySelector(".frame").dataset.decades, before, after: ticksOf(one) };
    });
    const wide = document.documentElement.scrollWidth > document.documentElement.clientWidth;
    document.body.dataset.probe = JSON.stringify({
      sheet, words, rows, reached, keys, litNear, litAgain, told, crosshair, barOver, barLeft, barsNear, saved,
      errors, sizes, readout, whole, near, again, ticksBefore, ticksNear, ticksAgain,
      astray, byWheel, stolenWheel: unfocused.defaultPrevented, keptWheel: focused.defaultPrevented, hidden, after, wide, rewritten,
    });
  });
})();
