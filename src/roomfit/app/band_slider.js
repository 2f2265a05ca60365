// The browser's own slider, which keeps its position while the page is drawn anew: keys and screen readers know it.
export default {
  template: `<label>{{ word }}: {{ own.toFixed(2) }}
    <input type="range" min="0.01" max="0.99" step="0.01" :value="own" :aria-label="label" @input="moved"></label>`,
  props: { word: String, label: String, start: Number },
  data() {
    return { own: this.start };
  },
  methods: {
    moved(e) {
      this.own = Number(e.target.value);
      this.$emit("moved", this.own);
    },
  },
};
