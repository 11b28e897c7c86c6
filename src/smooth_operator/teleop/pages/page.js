// What every 3D page needs besides its library: names for a screen reader, and a view without notices.
(() => {
  if (window.smoothOperatorPage) return; // sent again after a reconnection
  window.smoothOperatorPage = true;

  const ICONS = { adjustments: "Settings of the page", "list-search": "All commands" };

  // The library writes the label beside a slider, its number field or a text field, and leaves the
  // control itself without a name.
  const name = (control, words) => {
    if (control.getAttribute("aria-label") !== words) control.setAttribute("aria-label", words);
  };
  const nameControls = () => {
    for (const label of document.querySelectorAll("label[for]")) {
      const words = label.textContent.trim(), target = document.getElementById(label.htmlFor);
      if (!words || !target) continue;
      const row = target.matches(".mantine-Slider-root") ? target.parentElement : target;
      const controls = row.matches("input, textarea")
        ? [row] : row.querySelectorAll("[role=slider], input:not([type=hidden]), textarea");
      controls.forEach((control) => name(control, words));
    }
    for (const button of document.querySelectorAll("button")) {
      if (button.textContent.trim()) continue;
      const icon = button.querySelector("svg")?.getAttribute("class") ?? "";
      const key = Object.keys(ICONS).find((each) => icon.includes(`tabler-icon-${each}`));
      if (key) name(button, ICONS[key]);
      else if (button.matches(".mantine-CloseButton-root")) name(button, "Close");
    }
  };

  setInterval(() => {
    nameControls();
    // The live page says in its panel that the browser is slow, and this lies over the hands.
    for (const notice of document.querySelectorAll(".mantine-Notification-root"))
      if (notice.textContent.includes("Software WebGL"))
        notice.querySelector("button")?.click();
  }, 200);
})();
