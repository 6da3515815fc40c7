// Renewal of the views of a served page when the files change; camera, colours and layers stay.

const EVERY_MS = 1000;

// Layers, opacities and colours of another view of the same run, by their names.
const takeOver = (made, old) => {
  made.follow(old.camera);
  const rows = (viewer) => [...viewer.part("layers").querySelectorAll(".layer")];
  const settings = new Map(rows(old).map((row) => [row.textContent, row.querySelectorAll("input")]));
  for (const row of rows(made)) {
    row.querySelectorAll("input").forEach((input, n) => {
      const before = settings.get(row.textContent)?.[n];
      if (!before) return;
      const key = input.type === "checkbox" ? "checked" : "value";
      input[key] = before[key];
      input.dispatchEvent(new Event(input.type === "checkbox" ? "change" : "input"));
    });
  }
  const [select, chosen] = [made, old].map((viewer) => viewer.part("colours"));
  const same = [...select.options].find((option) => option.text === chosen.selectedOptions[0]?.text);
  if (same) {
    select.value = same.value;
    select.dispatchEvent(new Event("change"));
  }
};

const renew = (page) => {
  const [fresh, judged] = [".viewer", ".judged"].map((name) => page.querySelectorAll(name));
  document.querySelectorAll(".judged").forEach((old, n) => old.replaceWith(judged[n]));
  viewers.forEach((old, n) => {
    const root = document.importNode(fresh[n], true);
    old.root.replaceWith(root);
    viewers[n] = root.viewer = new Viewer(root);
    takeOver(viewers[n], old);
    old.painter.gl.getExtension("WEBGL_lose_context")?.loseContext(); // a browser has few
  });
  if (link && viewers.length > 1) setLinks(link.getAttribute("aria-pressed") === "true");
};

const text = async (address) => {
  const answer = await fetch(address);
  return answer.ok ? answer.text() : null; // not while the files are written
};

let shown = document.querySelector("main").dataset.files;
const ask = async () => {
  try {
    const version = await text("/version");
    if (version === null || version === shown || document.hidden) return;
    const page = new DOMParser().parseFromString((await text("/")) || "", "text/html");
    if (page.querySelectorAll(".viewer").length !== viewers.length) return;
    renew(page);
    shown = version;
  } catch { /* the server ended: the last view stays */ }
};
if (location.protocol.startsWith("http")) setInterval(ask, EVERY_MS); // not a saved page
