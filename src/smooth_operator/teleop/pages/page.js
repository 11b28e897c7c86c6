// Additions to viser on each 3D page: title and icon of the tab, names for a screen reader, no notices.
(() => {
  // Five fingers in their colours.
  const ICON =
    "data:image/svg+xml,<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'>" +
    "<g stroke-width='2.4' stroke-linecap='round'>" +
    "<path stroke='%23d55e00' d='M2.2 9.5 5 12'/><path stroke='%2356b4e9' d='M5 4v5'/>" +
    "<path stroke='%23009e73' d='M8 2.4V9'/><path stroke='%23cc79a7' d='M11 3.2V9'/>" +
    "<path stroke='%230072b2' d='M13.8 6v4'/></g>" +
    "<path fill='%23888' d='M4 9h10.5v3l-2 3H7z'/></svg>";
  let named = "";
  const nameTab = () => {
    const title = document.querySelector("[data-title]")?.dataset.title;
    if (!title || title === named) return;
    document.title = named = title;
    document.querySelector("link[rel~=icon]")?.setAttribute("href", ICON);
  };

  const ICONS = { adjustments: "Settings of the page", "list-search": "All commands" };

  // viser writes a label beside a control, which itself has no name.
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
    nameTab();
    nameControls();
    // This notice covers the hands. The panel of the live page reports a slow browser.
    for (const notice of document.querySelectorAll(".mantine-Notification-root"))
      if (notice.textContent.includes("Software WebGL"))
        notice.querySelector("button")?.click();
  }, 200);
})();
