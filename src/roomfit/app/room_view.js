// The room in three dimensions on a canvas: turned by dragging or by arrow keys, a surface chosen by a click.
// Faces are drawn from the farthest to the nearest; those towards the viewer are left out, so that the inside shows.
export default {
  template: `<canvas ref="c" tabindex="0" role="application" class="room-view"
    :aria-label="'The room in three dimensions. Arrow keys turn it. Its surfaces can be chosen in the list as well.'"
    @pointerdown="down" @pointermove="move" @pointerup="up" @keydown="key"></canvas>`,
  props: { room: Object, selected: Number, mark: Array },
  data: () => ({ azimuth: (-118 * Math.PI) / 180, elevation: Math.PI / 6, last: null, moved: false }),
  mounted() {
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.$refs.c);
    this.dark = new MutationObserver(() => this.draw());
    this.dark.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.draw();
  },
  unmounted() {
    this.observer.disconnect();
    this.dark.disconnect();
  },
  watch: {
    room: { handler: "draw", deep: true },
    selected: "draw",
    mark: "draw",
  },
  methods: {
    axes() {
      const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation), Math.sin(this.elevation)];
      return [[-sa, ca, 0], [-ca * se, -sa * se, ce], [ca * ce, sa * ce, se]];
    },
    draw() {
      const canvas = this.$refs.c;
      if (!canvas || !this.room || !this.room.vertices) return;
      const ratio = window.devicePixelRatio || 1;
      const [w, h] = [canvas.clientWidth, canvas.clientHeight];
      canvas.width = w * ratio;
      canvas.height = h * ratio;
      const g = canvas.getContext("2d");
      g.scale(ratio, ratio);
      const v = this.room.vertices;
      const [right, up, towards] = this.axes();
      const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
      const low = [0, 1, 2].map((k) => v.reduce((m, p) => Math.min(m, p[k]), Infinity));
      const high = [0, 1, 2].map((k) => v.reduce((m, p) => Math.max(m, p[k]), -Infinity));
      const middle = [0, 1, 2].map((k) => (low[k] + high[k]) / 2);
      const radius = Math.hypot(...[0, 1, 2].map((k) => high[k] - low[k])) / 2 || 1;
      const scale = Math.min(w, h * 1.25) / (2.1 * radius);
      const flat = (p) => {
        const d = [p[0] - middle[0], p[1] - middle[1], p[2] - middle[2]];
        return [w / 2 + scale * dot(d, right), h / 2 - scale * dot(d, up), dot(d, towards)];
      };
      const dark = document.body.classList.contains("body--dark");
      const drawn = [];
      for (const [a, b, c, s] of this.room.faces) {
        const [p, q, r] = [v[a], v[b], v[c]];
        const e = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
        const f = [r[0] - p[0], r[1] - p[1], r[2] - p[2]];
        const normal = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
        const away = dot(normal, towards);
        const surface = this.room.surfaces[s];
        if (away >= 0 && !(surface.sheet && away !== 0)) continue;
        const corners = [flat(p), flat(q), flat(r)];
        drawn.push({ corners, s, depth: (corners[0][2] + corners[1][2] + corners[2][2]) / 3 });
      }
      drawn.sort((a, b) => a.depth - b.depth);
      for (const { corners, s } of drawn) {
        g.beginPath();
        corners.forEach(([x, y], i) => (i ? g.lineTo(x, y) : g.moveTo(x, y)));
        g.closePath();
        const chosen = s === this.selected;
        g.fillStyle = chosen ? "#ffd54a" : this.room.materials[this.room.surfaces[s].material_index].colour;
        g.strokeStyle = g.fillStyle;
        g.lineWidth = 0.7;
        g.fill();
        g.stroke();
      }
      this.drawn = drawn;
      g.strokeStyle = dark ? "#c8c8c8" : "#444444";
      g.lineWidth = this.room.edges.length > 300 ? 0.5 : 1;
      g.beginPath();
      for (const [a, b] of this.room.edges) {
        g.moveTo(...flat(a).slice(0, 2));
        g.lineTo(...flat(b).slice(0, 2));
      }
      g.stroke();
      g.font = "12px sans-serif";
      const label = (text, x, y) => {
        const wide = g.measureText(text).width;
        g.fillStyle = dark ? "rgba(30,30,30,0.75)" : "rgba(255,255,255,0.75)";
        g.fillRect(x - wide / 2 - 3, y - 8, wide + 6, 15);
        g.fillStyle = dark ? "#e0e0e0" : "#333333";
        g.fillText(text, x - wide / 2, y + 4);
      };
      this.nameSurfaces(label);
      this.measure(g, label, flat, low, high, [right, up, towards]);
      const point = (p, colour, square) => {
        const [x, y] = flat(p.position_m);
        const [fx, fy] = flat([p.position_m[0], p.position_m[1], low[2]]);
        g.setLineDash([2, 3]);
        g.strokeStyle = "#222223";
        g.beginPath();
        g.moveTo(x, y);
        g.lineTo(fx, fy);
        g.stroke();
        g.setLineDash([]);
        g.fillStyle = colour;
        g.strokeStyle = "#ffffff";
        g.beginPath();
        if (square) g.rect(x - 5, y - 5, 10, 10);
        else g.arc(x, y, 5, 0, 7);
        g.fill();
        g.stroke();
        const wide = g.measureText(p.name).width;
        g.fillStyle = "rgba(255,255,255,0.85)";
        g.fillRect(x + 7, y - 8, wide + 4, 15);
        g.fillStyle = "#222222";
        g.fillText(p.name, x + 9, y + 4);
      };
      (this.room.receivers || []).forEach((p) => point(p, "#222222", false));
      (this.room.sources || []).forEach((p) => point(p, "#b34700", true));
      if (this.mark) {
        const [x, y] = flat(this.mark);
        g.strokeStyle = "#d00000";
        g.lineWidth = 3;
        g.beginPath();
        g.arc(x, y, 11, 0, 7);
        g.moveTo(x - 18, y);
        g.lineTo(x + 18, y);
        g.moveTo(x, y - 18);
        g.lineTo(x, y + 18);
        g.stroke();
      }
    },
    // names of surfaces where their largest triangle has the space for it
    nameSurfaces(label) {
      const best = new Map();
      for (const { corners: [a, b, c], s } of this.drawn) {
        const area = Math.abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
        const own = best.get(s) || { area: 0, x: 0, y: 0 };
        own.x += (area * (a[0] + b[0] + c[0])) / 3;
        own.y += (area * (a[1] + b[1] + c[1])) / 3;
        own.area += area;
        best.set(s, own);
      }
      const large = [...best].filter(([, own]) => own.area > 3000).sort((a, b) => b[1].area - a[1].area);
      for (const [s, own] of large.slice(0, 12)) label(this.room.surfaces[s].name, own.x / own.area, own.y / own.area);
    },
    // lengths along the edges of the box round the room that face the viewer, and where x, y and z lead
    measure(g, label, flat, low, high, [right, up, towards]) {
      const near = [0, 1, 2].map((k) => (towards[k] > 0 ? high[k] : low[k]));
      const base = towards[2] >= 0 ? low[2] : high[2];
      const upright = [[0, 0], [0, 1], [1, 0], [1, 1]]
        .map(([i, j]) => [[low, high][i][0], [low, high][j][1]])
        .sort((a, b) => flat([...a, base])[0] - flat([...b, base])[0])[0];
      const edges = [
        [[low[0], near[1], base], [high[0], near[1], base], 0, 14],
        [[near[0], low[1], base], [near[0], high[1], base], 0, 14],
        [[...upright, low[2]], [...upright, high[2]], -30, 0],
      ];
      edges.forEach(([from, to, dx, dy], k) => {
        const [[ax, ay], [bx, by]] = [flat(from), flat(to)];
        if (Math.hypot(bx - ax, by - ay) < 30) return;
        const x = Math.max(36, (ax + bx) / 2 + dx);
        label(`${"xyz"[k]} ${(high[k] - low[k]).toFixed(2)} m`, x, (ay + by) / 2 + dy);
      });
      const [x, y] = [34, 40];
      g.lineWidth = 1.5;
      g.strokeStyle = g.fillStyle;
      "xyz".split("").forEach((name, k) => {
        const [ex, ey] = [x + 22 * right[k], y - 22 * up[k]];
        g.beginPath();
        g.moveTo(x, y);
        g.lineTo(ex, ey);
        g.stroke();
        g.fillText(name, x + 30 * right[k] - 3, y - 30 * up[k] + 4);
      });
    },
    down(e) {
      this.last = [e.clientX, e.clientY];
      this.moved = false;
      this.$refs.c.setPointerCapture(e.pointerId);
    },
    move(e) {
      if (!this.last) return;
      const [dx, dy] = [e.clientX - this.last[0], e.clientY - this.last[1]];
      if (Math.abs(dx) + Math.abs(dy) < 4 && !this.moved) return;
      this.moved = true;
      this.last = [e.clientX, e.clientY];
      this.turn(-dx * 0.01, dy * 0.01);
    },
    up(e) {
      if (this.last && !this.moved) this.pick(e);
      this.last = null;
    },
    turn(azimuth, elevation) {
      this.azimuth += azimuth;
      this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + elevation));
      this.draw();
    },
    key(e) {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
      if (!step) return;
      e.preventDefault();
      this.turn(...step);
    },
    pick(e) {
      const box = this.$refs.c.getBoundingClientRect();
      const [x, y] = [e.clientX - box.left, e.clientY - box.top];
      const side = (a, b) => (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
      for (let i = this.drawn.length - 1; i >= 0; i--) {
        const [a, b, c] = this.drawn[i].corners;
        const signs = [side(a, b), side(b, c), side(c, a)];
        if (signs.every((n) => n >= 0) || signs.every((n) => n <= 0)) return this.$emit("pick", this.drawn[i].s);
      }
    },
  },
};
