// Files dropped or chosen are sent one by one, each as the body of a PUT; a pasted table goes the same way.
export default {
  template: `<div class="file-drop" :class="{ over: over }" @dragover.prevent="over = true" @dragleave="over = false" @drop.prevent="drop">
    <label class="file-label"><span>{{ label }}</span>
      <input ref="f" type="file" :multiple="multiple" :accept="accept" @change="chosen"></label>
    <details v-if="pasted"><summary>{{ pasted }}</summary>
      <textarea v-model="text" rows="5" spellcheck="false" :aria-label="pasted"></textarea>
      <button type="button" class="plain" :disabled="!text.trim()" @click="paste">Use the pasted table</button></details>
    <div role="status" class="file-status">{{ status }}</div></div>`,
  props: { label: String, place: String, accept: String, multiple: Boolean, pasted: String },
  data: () => ({ over: false, status: "", text: "" }),
  methods: {
    drop(e) {
      this.over = false;
      this.send([...e.dataTransfer.files]);
    },
    chosen() {
      this.send([...this.$refs.f.files]);
      this.$refs.f.value = "";
    },
    paste() {
      this.send([new File([this.text], "pasted.csv")]);
    },
    async send(files) {
      const [taken, refused] = [[], []];
      for (const [i, file] of files.entries()) {
        this.status = `Sending ${file.name} (${i + 1} of ${files.length})`;
        try {
          const answer = await fetch(`upload/${this.place}/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
          if (answer.ok) taken.push(file.name);
          else refused.push(`${file.name}: ${(await answer.text()).slice(0, 1200)}`);
        } catch (error) {
          refused.push(`${file.name}: not sent`);
        }
      }
      this.status = refused.length ? refused.join("\n") : `${taken.length} sent`;
      this.$emit("sent", { taken, refused });
    },
  },
};
