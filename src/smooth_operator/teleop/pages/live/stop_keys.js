// Keys and tab of the live page. Only Space, Esc and X stop, whatever control has the focus.
//
// viser ignores hotkeys in text fields, and buttons take Space for a click. So this script catches the
// stop keys first and sends the hotkey X from the document itself.
(() => {
  const stops = (event) =>
    event.key === " " ||
    event.key === "Escape" ||
    ((event.key === "x" || event.key === "X" || event.code === "KeyX") &&
      !event.ctrlKey && !event.metaKey && !event.altKey); // Ctrl+X cuts

  const types = (target) =>
    target instanceof HTMLElement &&
    (target.isContentEditable ||
      (target.matches("input, textarea") && !target.readOnly &&
        !["checkbox", "radio", "range", "button", "submit"].includes(target.type)));

  const caught = (event) => {
    if (!event.isTrusted || !stops(event)) return;
    // A text field also gets the character; elsewhere the key has no other effect.
    if (event.key !== "Escape" && !types(event.target)) event.preventDefault();
    if (event.key !== "Escape") event.stopPropagation();
    if (event.type !== "keydown" || event.repeat) return;
    if (event.key === "Escape") document.activeElement?.blur(); // so that U and P are hotkeys again
    document.documentElement.dispatchEvent(
      new KeyboardEvent("keydown", { key: "x", code: "KeyX", bubbles: true }),
    );
  };
  window.addEventListener("keydown", caught, true);
  window.addEventListener("keyup", caught, true); // Firefox clicks a button on the release of Space

  // A button with the focus would take the next Space or Enter for another click.
  window.addEventListener("click", (event) => {
    const button = event.target instanceof Element && event.target.closest("button");
    if (button) setTimeout(() => button.blur());
  }, true);

  const LOST = "⚠ CONNECTION LOST", STOPPED = "■ STOPPED";
  let title = document.title;
  setInterval(() => {
    const stopped = document.querySelector("[data-stopped]") !== null;
    const lost = document.documentElement.hasAttribute("data-lost");
    if (![LOST, STOPPED].includes(document.title)) title = document.title;
    document.title = lost ? LOST : stopped ? STOPPED : title;
  }, 200);
})();
