// Plays sweeps and records them in one audio context. The same file is the worklet that hands each block of samples on.
if (globalThis.registerProcessor)
  registerProcessor("recorder", class extends AudioWorkletProcessor {
    process([input]) {
      this.port.postMessage([currentFrame, input[0] ? input[0].slice() : new Float32Array(128)]);
      return true;
    }
  });

// What a browser does to speech; it spoils a response.
const CHANGES = ["echoCancellation", "noiseSuppression", "autoGainControl", "voiceIsolation"];
const WORDS = { echoCancellation: "echo cancelling", noiseSuppression: "noise suppression", autoGainControl: "automatic gain", voiceIsolation: "voice isolation" };
const level = (x) => (x > 1e-10 ? 20 * Math.log10(x) : -200);

export default {
  template: `<div>
    <div class="bar">
      <button type="button" class="plain" :disabled="state === 'playing' || state === 'opening'" @click="open">{{ isOpen ? "Close the microphone" : "Open the microphone" }}</button>
      <label v-if="microphones.length > 1" class="file-label"><span>Microphone</span>
        <select v-model="chosen" @change="reopen"><option v-for="m in microphones" :key="m.deviceId" :value="m.deviceId">{{ m.label || m.deviceId }}</option></select></label>
      <button type="button" class="plain" :disabled="state !== 'open'" @click="measure">Play and record</button>
    </div>
    <meter v-if="isOpen" min="-90" max="0" high="-6" :value="Math.max(peak, -90)" aria-label="Level of the microphone"></meter>
    <div v-if="isOpen" class="file-status">peak {{ peak.toFixed(0) }} dBFS, mean {{ mean.toFixed(0) }} dBFS{{ clipped ? ", clipped" : "" }}</div>
    <div role="status" class="file-status">{{ status }}</div>
    <div v-for="w in warnings" :key="w" class="finding warning"><b>Warning</b>{{ w }}</div></div>`,
  props: { asked: Object },
  data: () => ({ state: "closed", status: "", warnings: [], microphones: [], chosen: "", peak: -200, mean: -200, clipped: false }),
  computed: {
    isOpen() {
      return this.state === "open" || this.state === "playing";
    },
  },
  created() {
    this.sound = null; // context, stream: kept from Vue, which would wrap them
    this.record = null;
    this.recent = [];
  },
  unmounted() {
    this.close();
  },
  methods: {
    async open() {
      if (this.state !== "closed") return this.close();
      this.status = "";
      this.state = "opening"; // a second click must not open it twice
      try {
        await this.start();
      } catch (error) {
        this.close();
        this.status = `The microphone cannot be used: ${error.message || error.name}`;
      }
    },
    async reopen() {
      this.close();
      await this.open();
    },
    async start() {
      if (!navigator.mediaDevices) throw new Error("browsers give it to pages of this machine (127.0.0.1) or over HTTPS only");
      const context = new AudioContext({ latencyHint: "playback" });
      this.sound = { context };
      const off = Object.fromEntries(CHANGES.map((key) => [key, false]));
      const device = this.chosen ? { deviceId: { exact: this.chosen } } : {};
      const stream = await navigator.mediaDevices.getUserMedia({ audio: { ...off, ...device, channelCount: 1 } });
      this.sound.stream = stream;
      const settings = stream.getAudioTracks()[0].getSettings();
      const on = CHANGES.filter((key) => settings[key] !== undefined && settings[key] !== false);
      if (on.length) throw new Error(`the browser leaves ${on.map((k) => WORDS[k]).join(", ")} on; take another browser or microphone, or roomfit measure`);
      const silent = CHANGES.slice(0, 3).filter((key) => settings[key] === undefined);
      this.warnings = [];
      if (silent.length) this.warnings.push(`The browser does not say whether ${silent.map((k) => WORDS[k]).join(", ")} is off.`);
      if (settings.sampleRate && settings.sampleRate !== context.sampleRate)
        this.warnings.push(`The browser resamples from ${settings.sampleRate} to ${context.sampleRate} Hz.`);
      await context.audioWorklet.addModule(import.meta.url);
      await context.resume();
      const recorder = new AudioWorkletNode(context, "recorder"); // of several channels it takes the first: a mean of two microphones is a comb filter
      recorder.port.onmessage = (e) => this.take(...e.data);
      context.createMediaStreamSource(stream).connect(recorder).connect(context.destination); // which is silent, and keeps it going
      this.microphones = (await navigator.mediaDevices.enumerateDevices()).filter((d) => d.kind === "audioinput");
      this.chosen = settings.deviceId || this.chosen;
      this.state = "open";
    },
    close() {
      const { context, stream } = this.sound || {};
      if (stream) stream.getTracks().forEach((t) => t.stop());
      if (context) context.close();
      this.sound = this.record = null;
      this.state = "closed";
      this.warnings = [];
    },
    take(frame, block) {
      const r = this.record;
      if (r && frame + block.length > r.from && frame < r.from + r.samples.length) {
        const skip = Math.max(0, r.from - frame);
        const part = block.subarray(skip, Math.min(block.length, r.from + r.samples.length - frame));
        r.samples.set(part, frame + skip - r.from);
        r.taken += part.length;
        if (r.taken >= r.samples.length) r.done();
      }
      this.recent.push(block);
      if (this.recent.length < 64) return;
      let [peak, sum] = [0, 0];
      for (const b of this.recent) for (const x of b) [peak, sum] = [Math.max(peak, Math.abs(x)), sum + x * x];
      this.peak = level(peak);
      this.mean = level(Math.sqrt(sum / (64 * block.length)));
      this.clipped = peak >= 0.9999;
      this.recent = [];
    },
    async measure() {
      this.state = "playing";
      const { context } = this.sound;
      const { source, receiver } = this.asked; // which may be typed anew meanwhile
      const asked = new URLSearchParams({ ...this.asked, rate_hz: context.sampleRate });
      try {
        const answer = await fetch(`sweeps?${asked}`);
        if (!answer.ok) throw new Error(await answer.text());
        const played = new Float32Array(await answer.arrayBuffer());
        const recorded = await this.playAndRecord(played);
        this.status = "Computing the response";
        const sent = await fetch(`upload/measured?${asked}`, { method: "PUT", body: recorded });
        if (!sent.ok) throw new Error(await sent.text());
        const quality = await sent.json();
        this.status = quality.again.length ? "Measured, but not good enough" : "Measured";
        this.$emit("measured", { ...quality, source, receiver });
      } catch (error) {
        this.status = error.message;
      }
      this.record = null;
      if (this.sound) this.state = "open";
    },
    async playAndRecord(played) {
      const { context } = this.sound;
      const buffer = context.createBuffer(1, played.length, context.sampleRate);
      buffer.copyToChannel(played, 0);
      const from = Math.ceil((context.currentTime + 0.5) * context.sampleRate);
      const seconds = played.length / context.sampleRate;
      const player = context.createBufferSource();
      player.buffer = buffer;
      player.connect(context.destination);
      const whole = new Promise((done) => (this.record = { from, samples: new Float32Array(played.length), taken: 0, done: () => done(true) }));
      player.start(from / context.sampleRate);
      this.status = `Playing for ${seconds.toFixed(0)} s: keep still`;
      const late = new Promise((done) => setTimeout(done, 1000 * (seconds + 5), false));
      const { samples } = this.record;
      if (!(await Promise.race([whole, late]))) throw new Error("the browser has lost samples; close other programs and measure again");
      return samples;
    },
  },
};
