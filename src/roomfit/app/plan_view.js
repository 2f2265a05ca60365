// The room from above, with sources and receivers that can be dragged; the table beside it does the same by keys.
export default {
  template: `<svg ref="s" class="plan-view" :viewBox="box" role="img" @pointermove="move" @pointerup="drop" @pointercancel="drag = null"
      aria-label="The room from above. Sources and receivers can be dragged, or typed into the table.">
    <line v-for="(e, i) in plan.edges" :key="'e' + i" :x1="e[0]" :y1="-e[1]" :x2="e[2]" :y2="-e[3]" stroke="currentColor" :stroke-width="unit * 0.8" />
    <text v-for="(w, i) in walls" :key="'w' + i" class="plan-wall" :x="w.at[0]" :y="-w.at[1] + unit * 4" :font-size="unit * 12" text-anchor="middle">{{ w.name }}</text>
    <text v-for="(d, i) in lengths" :key="'d' + i" class="plan-wall" :x="d.at[0]" :y="-d.at[1]" :font-size="unit * 12" text-anchor="middle" :transform="d.turn">{{ d.text }}</text>
    <g v-for="p in shown" :key="p.kind + p.name" class="plan-point" :data-point="p.name" @pointerdown="take(p, $event)">
      <circle :cx="p.at[0]" :cy="-p.at[1]" :r="unit * 14" fill="transparent" />
      <rect v-if="p.kind === 'sources'" :x="p.at[0] - unit * 5" :y="-p.at[1] - unit * 5" :width="unit * 10" :height="unit * 10" class="plan-source" :stroke-width="unit" />
      <circle v-else :cx="p.at[0]" :cy="-p.at[1]" :r="unit * 5.5" class="plan-receiver" :stroke-width="unit" />
      <text :x="p.at[0] + unit * 9" :y="-p.at[1] + unit * 4" :font-size="unit * 12" fill="currentColor">{{ p.text }}</text>
    </g></svg>`,
  props: { plan: Object },
  data: () => ({ drag: null, unit: 0.02 }),
  mounted() {
    this.observer = new ResizeObserver(() => this.measure());
    this.observer.observe(this.$refs.s);
    this.measure();
  },
  unmounted() {
    this.observer.disconnect();
  },
  computed: {
    ends() {
      const ends = this.plan.edges.flatMap((e) => [[e[0], e[1]], [e[2], e[3]]]);
      const known = this.plan.points.filter((p) => p.position_m).map((p) => p.position_m);
      const all = [...ends, ...known].length ? [...ends, ...known] : [[0, 0], [1, 1]];
      const [low, high] = [Math.min, Math.max].map((f) => [0, 1].map((k) => all.reduce((m, p) => f(m, p[k]), all[0][k])));
      return { low, high };
    },
    box() {
      const { low, high } = this.ends;
      const edge = 0.1 * Math.max(high[0] - low[0], high[1] - low[1], 1);
      return `${low[0] - edge} ${-high[1] - edge} ${high[0] - low[0] + 2 * edge} ${high[1] - low[1] + 2 * edge}`;
    },
    lengths() { // of the edges alone: what stands outside does not make the room longer
      const ends = this.plan.edges.flatMap((e) => [[e[0], e[1]], [e[2], e[3]]]);
      if (!ends.length) return [];
      const [low, high] = [Math.min, Math.max].map((f) => [0, 1].map((k) => ends.reduce((m, p) => f(m, p[k]), ends[0][k])));
      const words = [0, 1].map((k) => `${(high[k] - low[k]).toFixed(2)} m`);
      const below = [(low[0] + high[0]) / 2, low[1] - 16 * this.unit];
      const beside = [low[0] - 7 * this.unit, (low[1] + high[1]) / 2];
      return [{ at: below, text: words[0] }, { at: beside, text: words[1], turn: `rotate(-90 ${beside[0]} ${-beside[1]})` }];
    },
    walls() { // a little inside of each
      const { low, high } = this.ends;
      const middle = [0, 1].map((k) => (low[k] + high[k]) / 2);
      return this.plan.walls.map(([x, y, name]) => {
        const [dx, dy] = [middle[0] - x, middle[1] - y];
        const far = Math.hypot(dx, dy) || 1;
        return { name, at: [x + (dx / far) * 24 * this.unit, y + (dy / far) * 14 * this.unit] };
      });
    },
    shown() {
      const { low, high } = this.ends;
      // what has no position yet stands in rows along the lower wall, names beside each other
      const wide = high[0] - low[0], step = Math.max(wide / 12, 56 * this.unit);
      const inRow = Math.max(1, Math.floor(wide / step) - 1);
      let waiting = 0;
      const queue = () => [low[0] + step * (0.5 + (waiting % inRow)), low[1] + this.unit * (32 + 18 * Math.floor(waiting++ / inRow))];
      return this.plan.points.map((p) => {
        const held = this.drag && this.drag.kind === p.kind && this.drag.name === p.name;
        const at = held ? this.drag.at : p.position_m || queue();
        const text = held ? `${p.name} ${at[0].toFixed(2)}, ${at[1].toFixed(2)}` : p.position_m ? p.name : `${p.name}?`;
        return { ...p, at, text };
      });
    },
  },
  watch: { plan: { handler: "measure", deep: true } },
  methods: {
    measure() {
      this.$nextTick(() => {
        const matrix = this.$refs.s && this.$refs.s.getScreenCTM();
        if (matrix && matrix.a) this.unit = 1 / matrix.a;
      });
    },
    place(e) {
      const p = new DOMPoint(e.clientX, e.clientY).matrixTransform(this.$refs.s.getScreenCTM().inverse());
      return [p.x, -p.y];
    },
    take(p, e) {
      const [x, y] = this.place(e);
      this.drag = { kind: p.kind, name: p.name, at: [...p.at], off: [p.at[0] - x, p.at[1] - y], moved: false };
      this.$refs.s.setPointerCapture(e.pointerId);
    },
    move(e) {
      if (!this.drag) return;
      const [x, y] = this.place(e);
      const at = [x + this.drag.off[0], y + this.drag.off[1]].map((v) => Math.round(100 * v) / 100);
      this.drag = { ...this.drag, at, moved: true };
    },
    drop() {
      const { kind, name, at, moved } = this.drag || {};
      this.drag = null;
      if (moved) this.$emit("dropped", { kind, name, at });
    },
  },
};
