// Elements and dialogs.

const PRESSED = "button:active, a:active, .link:active";

export function element(tag, properties = {}, ...children) {
  const { style, ...rest } = properties;
  const made = Object.assign(document.createElement(tag), rest);
  if (style) made.style.cssText = style;
  made.append(...children);
  return made;
}

// A sentence as nodes, with what stands between backticks as code.
export const prose = (text) => text.split("`").map((part, i) => (i % 2 ? element("code", { textContent: part }) : part));

// New children for a list; the button with the keyboard focus keeps it: by its data-key, else by its position. While
// something in the list is pressed they wait: an element that is gone when the mouse lets go never hears the click.
const newest = new WeakMap();
export function refill(list, ...children) {
  newest.set(list, children);
  if (!list.querySelector(PRESSED)) return replace(list, children);
  requestAnimationFrame(() => { if (newest.get(list) === children) refill(list, ...children); });
}

function replace(list, children) {
  const buttons = () => [...list.querySelectorAll("button")];
  const at = buttons().indexOf(document.activeElement), key = document.activeElement.dataset.key;
  list.replaceChildren(...children);
  if (at < 0) return;
  const again = key ? buttons().find((button) => button.dataset.key === key) : buttons()[at];
  again?.focus();
}

// Show content in a dialog; resolves with its returnValue when it is closed. Each has an element of its own: its
// "close" event comes later than the closing, when another one may be open already.
export function show(...content) {
  const dialog = element("dialog", {}, ...content);
  document.body.append(dialog);
  dialog.showModal();
  dialog.scrollTop = 0; // the focus goes to the first button, which may stand at the end
  return new Promise((resolve) => dialog.addEventListener("close", () => {
    dialog.remove();
    resolve(dialog.returnValue);
  }, { once: true }));
}

export const closeDialog = (value = "") => document.querySelector("dialog[open]")?.close(value);

// Ask for some texts; returns their values in order, or null when cancelled.
export async function ask(title, fields) {
  const inputs = fields.map(({ label, value, rows }) => {
    const input = element(rows ? "textarea" : "input", { value: value ?? "", ariaLabel: label });
    return { input, line: element("label", {}, `${label} `, input) };
  });
  const form = element("form", { method: "dialog" },
    element("b", { textContent: title }),
    ...inputs.map(({ line }) => line),
    element("div", { className: "row" },
      element("button", { className: "primary", value: "ok", textContent: "OK" }),
      element("button", { value: "", textContent: "Cancel", type: "button", onclick: () => closeDialog() })));
  const answer = show(form);
  (inputs[0]?.input || form.querySelector("button")).focus();
  inputs[0]?.input.select?.();
  return (await answer) === "ok" ? inputs.map(({ input }) => input.value.trim()) : null;
}
