// Pictures and films of the view, with its scales, saved as files.

// Draw the view onto a sheet with marks, ruler and colours.
function drawSheet(viewer, sheet) {
  viewer.draw(); // the buffer is empty after it was shown
  const { canvas } = viewer;
  if (sheet.width !== canvas.width || sheet.height !== canvas.height) {
    [sheet.width, sheet.height] = [canvas.width, canvas.height];
  }
  const pen = sheet.getContext("2d");
  const style = getComputedStyle(viewer.root);
  const ink = style.getPropertyValue("--ink").trim();
  const ratio = canvas.width / canvas.clientWidth;
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.fillStyle = style.getPropertyValue("--stage").trim();
  pen.fillRect(0, 0, sheet.width, sheet.height);
  pen.drawImage(canvas, 0, 0);
  pen.scale(ratio, ratio);
  pen.font = "13px system-ui, sans-serif";
  pen.fillStyle = pen.strokeStyle = ink;
  pen.lineWidth = 2;
  const marked = viewer.picks.map(({ point }) => viewer.onCanvas(point)).filter(Boolean);
  pen.beginPath();
  marked.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
  for (const [x, y] of marked) {
    pen.beginPath();
    pen.arc(x, y, 5, 0, 2 * Math.PI);
    pen.stroke();
  }
  const bottom = canvas.clientHeight - 16;
  pen.fillRect(16, bottom - 4, parseFloat(viewer.part("bar").style.width), 4);
  pen.fillText(viewer.part("length").textContent, 16, bottom - 10);
  const drawn = viewer.attribute && !viewer.attribute.classes && viewer.attribute;
  if (!drawn) return;
  const left = canvas.clientWidth - 216;
  const fade = pen.createLinearGradient(left, 0, left + 200, 0);
  drawn.colours.forEach((colour, i) => fade.addColorStop(i / (drawn.colours.length - 1), colour));
  pen.fillText(`${drawn.label}${drawn.unit ? ` [${drawn.unit}]` : ""}: ${drawn.range[0]} to ${drawn.range[1]}`, left, bottom - 16);
  pen.fillStyle = fade;
  pen.fillRect(left, bottom - 10, 200, 10);
}

function saveBlob(blob, name) {
  const link = element("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function savePicture(viewer) {
  const sheet = element("canvas");
  drawSheet(viewer, sheet);
  sheet.toBlob((blob) => saveBlob(blob, `${viewer.scene.name}.png`));
}

const TURN_MS = 5000;

// Kind of film that this browser records, or undefined.
const filmKind = () => window.MediaRecorder && ["video/webm", "video/mp4"].find((kind) => MediaRecorder.isTypeSupported(kind));

// Record one turn around the vertical.
function saveTurn(viewer) {
  const button = viewer.part("film");
  const sheet = element("canvas");
  drawSheet(viewer, sheet);
  const kind = filmKind();
  const recorder = new MediaRecorder(sheet.captureStream(30), { mimeType: kind, videoBitsPerSecond: 6e6 });
  const parts = [];
  recorder.ondataavailable = (event) => parts.push(event.data);
  const start = viewer.camera.azimuth;
  recorder.onstop = () => {
    viewer.camera.azimuth = start;
    viewer.redraw();
    button.disabled = false;
    button.textContent = "save a turn";
    saveBlob(new Blob(parts, { type: kind }), `${viewer.scene.name}.${kind.slice(6)}`);
  };
  const began = performance.now();
  const step = () => {
    const share = (performance.now() - began) / TURN_MS;
    if (share >= 1) return recorder.stop();
    viewer.camera.azimuth = start + 2 * Math.PI * share;
    drawSheet(viewer, sheet);
    button.textContent = `turning, ${Math.round(100 * share)} %`;
    return requestAnimationFrame(step);
  };
  button.disabled = true;
  recorder.start();
  step();
}
