// Sound of contact: a tone that is louder and higher the more a finger of the robot touches.
//
// The panel writes the level (0 to 1) into an element only while the sound is switched on, and 0 unless
// the operator moves the robot.
(() => {
  const LOUDEST = 0.2; // gain at full contact
  const [LOW, HIGH] = [220, 660]; // Hz
  const SOON = 0.02; // s within which the tone follows
  let audio, tone, gain;
  const level = () => {
    if (document.documentElement.hasAttribute("data-lost")) return 0;
    return Math.min(+(document.querySelector("[data-contact]")?.dataset.contact ?? 0), 1);
  };
  setInterval(() => {
    const now = level();
    if (!audio) {
      if (!now) return;
      audio = new AudioContext();
      tone = audio.createOscillator();
      gain = audio.createGain();
      gain.gain.value = 0;
      tone.connect(gain).connect(audio.destination);
      tone.start();
    }
    gain.gain.setTargetAtTime(LOUDEST * now, audio.currentTime, SOON);
    tone.frequency.setTargetAtTime(LOW + (HIGH - LOW) * now, audio.currentTime, SOON);
  }, 20);
})();
