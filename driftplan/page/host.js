// Who answers what the page cannot compute: nobody in a file, the local server of `driftplan studio`, or a notebook.
import { el } from "./dom.js";
import { mount } from "./studio.js";

/** A studio in a page of its own; it may ask the server that sent it, or nobody. */
export function open({ asks, saves }) {
  mount(document.getElementById("studio"), JSON.parse(document.getElementById("scene").textContent), asks ? { saves, ask: askServer } : null);
}

/** Answers come as lines of JSON: progress, then the answer or an error. */
async function askServer(what, question, onProgress, signal) {
  const response = await fetch(`ask/${what}`, { method: "POST", signal, body: JSON.stringify(question),
    headers: { "Content-Type": "application/json" } });
  if (!response.ok) throw new Error(await response.text());
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  for (let rest = ""; ;) {
    const { value, done } = await reader.read();
    if (done) throw new Error("the server stopped before it had answered");
    const lines = (rest + value).split("\n");
    rest = lines.pop();
    for (const line of lines) {
      const { progress, answer, error } = JSON.parse(line);
      if (error) throw new Error(error);
      if (answer) return answer;
      onProgress(progress);
    }
  }
}

/** A studio in a notebook: anywidget calls this. */
export function render({ model, el: element }) {
  const waiting = new Map();
  let asked = 0;
  model.on("msg:custom", ({ id, progress, answer, error }) => {
    const { resolve, reject, onProgress } = waiting.get(id) ?? {};
    if (progress) return onProgress?.(progress);  // nobody hears what was stopped
    waiting.delete(id);
    return error ? reject?.(new Error(error)) : resolve?.(answer);
  });
  const ask = (what, question, onProgress, signal) => new Promise((resolve, reject) => {
    const id = asked++;
    waiting.set(id, { resolve, reject, onProgress });
    signal.addEventListener("abort", () => {
      if (!waiting.delete(id)) return;
      reject(new Error("stopped"));
      model.send({ id, what: "stop" });
    });
    model.send({ id, what, question });
  });
  const root = element.appendChild(el("div", { class: "in-notebook",  // its keys are not the notebook's: “x” would cut the cell
    onfocusin: ({ target }) => target.setAttribute("data-lm-suppress-shortcuts", "") }));
  const studio = mount(root, model.get("scene"), { saves: false, ask });
  studio.session.listen(() => {
    if (studio.session.merging !== null) return;  // in the middle of a drag
    model.set("scene", studio.session.scene);
    model.save_changes();
  });
}
