// Space plays and pauses, as in every other player, except where a person types.
//
// The page's library takes Space for a click on the control that has the focus, so it is caught before
// and passed on as the hotkey K.
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
  window.addEventListener("keyup", caught, true); // Firefox clicks a button when Space comes up
})();
