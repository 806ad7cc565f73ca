// Pictures that come from files and go to files.

/** A picture as grey levels of some size: it fills the size, cut off at the sides that are too long. */
export async function readGrey(file, rows, cols) {
  const bitmap = await createImageBitmap(file);
  const context = new OffscreenCanvas(cols, rows).getContext("2d");
  const scale = Math.max(cols / bitmap.width, rows / bitmap.height);
  const [width, height] = [scale * bitmap.width, scale * bitmap.height];
  context.fillRect(0, 0, cols, rows);
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, (cols - width) / 2, (rows - height) / 2, width, height);
  const { data } = context.getImageData(0, 0, cols, rows), levels = new Uint8Array(rows * cols);
  // The weights of the colours in their brightness (ITU-R BT.601).
  levels.forEach((_, k) => { levels[k] = Math.round(0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2]); });
  return levels;
}

/** Grey levels as a picture. */
export function greyImage(levels, rows, cols) {
  const image = new ImageData(cols, rows);
  levels.forEach((level, k) => image.data.set([level, level, level, 255], 4 * k));
  return image;
}

/** Offer a picture as a file. */
export async function download(image, name) {
  const canvas = new OffscreenCanvas(image.width, image.height);
  canvas.getContext("2d").putImageData(image, 0, 0);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await canvas.convertToBlob({ type: "image/png" }));
  link.download = `${name}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
