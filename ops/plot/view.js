/* The span of time that plots show, and what the mouse, fingers and keys do with it. */
"use strict";

const HealthPlotViews = (() => {
const CLICK = 5;  // pixels: a shorter way of the mouse selects nothing

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

class View {
  constructor(from, to, utcOffset) {
    this.first = from;
    this.last = Math.max(to, from + 1e-3);
    this.from = this.first;
    this.to = this.last;
    this.utcOffset = utcOffset || 0;
    this.onChange = [];
    this.pending = false;
    /** Called when the user zooms out of the whole; null: nothing is beyond. */
    this.beyond = null;
  }

  get isWhole() { return this.from <= this.first && this.to >= this.last; }

  show(from, to) {
    const whole = this.last - this.first;
    const span = clamp(to - from, Math.min(whole, 0.01), whole);
    const start = clamp((from + to - span) / 2, this.first, this.last - span);
    this.from = start;
    this.to = start + span;
    if (!this.pending) {
      this.pending = true;
      requestAnimationFrame(() => { this.pending = false; this.onChange.forEach((draw) => draw()); });
    }
  }

  showAll() { this.show(this.first, this.last); }

  /** Changes the span of the data; what was zoomed to stays. Update the plots afterwards. */
  extend(first, last) {
    const {isWhole} = this;
    this.first = first;
    this.last = Math.max(last, first + 1e-3);
    if (isWhole) [this.from, this.to] = [this.first, this.last];
    else this.from = clamp(this.from, this.first, Math.max(this.first, this.last - (this.to - this.from)));
  }

  zoom(factor, around) {
    if (factor > 1 && this.isWhole && this.beyond) {
      this.beyond();
      return;
    }
    const center = around === undefined ? (this.from + this.to) / 2 : around;
    this.show(center - (center - this.from) * factor, center + (this.to - center) * factor);
  }

  move(share) {
    const span = this.to - this.from;
    const from = clamp(this.from + share * span, this.first, this.last - span);
    this.show(from, from + span);
  }
}

/** Base of a plot. */
class Gestures {
  constructor() {
    this.pointers = new Map();
  }

  selection(pointer) {
    return [pointer.start, pointer.x].sort((one, other) => one - other).map((x) => this.inside(x));
  }

  place(event) {
    const box = this.svg.getBoundingClientRect();
    return (event.clientX - box.left) / box.width * this.width;
  }

  listen() {
    const {svg, view} = this;
    svg.addEventListener("wheel", (event) => {
      // Without focus or Ctrl the wheel scrolls the page.
      if (!event.ctrlKey && document.activeElement !== svg) return;
      event.preventDefault();
      view.zoom(event.deltaY > 0 ? 1.25 : 0.8, this.t(this.inside(this.place(event))));
    }, {passive: false});
    svg.addEventListener("keydown", (event) => {
      const actions = {
        "+": () => view.zoom(0.5), "=": () => view.zoom(0.5), "-": () => view.zoom(2), "0": () => view.showAll(),
        ArrowLeft: () => view.move(-0.2), ArrowRight: () => view.move(0.2), Escape: () => { this.at = null; this.draw(); },
      };
      if (event.target !== svg || event.ctrlKey || event.altKey || event.metaKey || !actions[event.key]) return;
      event.preventDefault();
      actions[event.key]();
    });
    svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "mouse" && event.button !== 0) return;
      if (event.target.closest("a")) return;
      const x = this.place(event);
      this.pointers.set(event.pointerId, {type: event.pointerType, start: x, x, pan: event.shiftKey});
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      const pointer = this.pointers.get(event.pointerId), x = this.place(event);
      if (this.pointers.size === 2 && pointer) {
        this.pinch(pointer, x);
      } else if (pointer && pointer.pan) {
        view.move((this.t(pointer.x) - this.t(x)) / (view.to - view.from));
        pointer.x = x;
      } else {
        if (pointer) pointer.x = x;
        this.at = this.t(this.inside(x));
        this.drawCursor();
        if (pointer && pointer.type === "mouse" && Math.abs(x - pointer.start) > CLICK) this.drawSelection(pointer);
      }
    });
    const release = (event) => {
      const pointer = this.pointers.get(event.pointerId);
      this.pointers.delete(event.pointerId);
      if (!pointer || event.type === "pointercancel") return;
      const [from, to] = this.selection(pointer);
      if (pointer.type === "mouse" && !pointer.pan && to - from > CLICK) {
        view.show(this.t(from), this.t(to));
      } else if (pointer.type !== "mouse") {
        this.at = this.t(this.inside(pointer.x));
        this.drawCursor();
      }
    };
    svg.addEventListener("pointerup", release);
    svg.addEventListener("pointercancel", release);
    svg.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse" && !this.pointers.size) { this.at = null; this.drawCursor(); }
    });
    svg.addEventListener("dblclick", () => view.showAll());
  }

  pinch(moved, x) {
    const [other] = [...this.pointers.values()].filter((pointer) => pointer !== moved);
    const before = Math.abs(moved.x - other.x), after = Math.abs(x - other.x);
    if (before > 5 && after > 5) this.view.zoom(before / after, this.t((x + other.x) / 2));
    moved.x = x;
  }
}

return {Gestures, View, clamp};
})();
