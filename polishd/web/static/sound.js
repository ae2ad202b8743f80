// The alarm sound: tones made in the browser, so that nothing is loaded and nothing can be missing at night.
const AGAIN_MS = 20_000;
const stored = () => { try { return localStorage.getItem("polishd.sound") !== "off"; } catch { return true; } };
let context = null, timer = null, severity = null;

function ready() {
  context ??= new AudioContext();
  if (context.state === "suspended") context.resume().catch(() => {});
  return context.state === "running";
}

// Three tones: rising for a warning, a high and low alternation for an alarm.
function play(kind) {
  if (!ready()) return false;
  const tones = kind === "alarm" ? [988, 740, 988, 740, 988, 740] : [587, 740, 880];
  const length = kind === "alarm" ? 0.22 : 0.28;
  tones.forEach((hertz, k) => {
    const from = context.currentTime + 0.02 + k * (length + 0.04), oscillator = context.createOscillator(), gain = context.createGain();
    oscillator.type = "triangle";
    oscillator.frequency.value = hertz;
    gain.gain.setValueAtTime(0, from);
    gain.gain.linearRampToValueAtTime(0.5, from + 0.02);
    gain.gain.setValueAtTime(0.5, from + length - 0.04);
    gain.gain.linearRampToValueAtTime(0, from + length);
    oscillator.connect(gain).connect(context.destination);
    oscillator.start(from);
    oscillator.stop(from + length);
  });
  return true;
}

export const sound = {
  get on() { return stored(); },
  set on(value) {
    try { localStorage.setItem("polishd.sound", value ? "on" : "off"); } catch { /* private window */ }
    if (!value) sound.silence();
  },
  // A browser plays nothing before the first click or key on the page.
  get blocked() { return !context || context.state !== "running"; },
  get sounding() { return severity !== null; },
  unlock() { ready(); },
  // Resolves to whether it was played.
  async test() {
    context ??= new AudioContext();
    // A browser that allows no sound keeps the promise waiting.
    await Promise.race([context.resume().catch(() => {}), new Promise((done) => setTimeout(done, 1000))]);
    return play("alarm");
  },
  // Sound now and every 20 s, until silenced.
  start(kind) {
    if (!stored() || severity === "alarm" || severity === kind) return;
    sound.silence();
    severity = kind;
    play(kind);
    timer = setInterval(() => play(kind), AGAIN_MS);
  },
  silence() {
    clearInterval(timer);
    timer = severity = null;
  },
};
