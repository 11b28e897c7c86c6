// Space plays and pauses, except in a text field.
//
// viser takes Space for a click on the control that has the focus, so this script catches the key first
// and sends the hotkey K instead.
(() => {
  const caught = (event) => {
    if (event.key !== " " || !event.isTrusted) return;
    const at = event.target;
    if (at instanceof HTMLElement && at.matches("input:not([type=checkbox]), textarea")) return;
    event.preventDefault();
    event.stopPropagation();
    if (event.type !== "keydown" || event.repeat) return;
    document.documentElement.dispatchEvent(
      new KeyboardEvent("keydown", { key: "k", code: "KeyK", bubbles: true }),
    );
  };
  window.addEventListener("keydown", caught, true);
  window.addEventListener("keyup", caught, true); // Firefox clicks a button on the release of Space
})();
