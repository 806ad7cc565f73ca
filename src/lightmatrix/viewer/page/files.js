// Pictures that come from files and go to files.

/** A picture as grey levels of some size, with black bars where its shape differs, and words for this. */
export async function readGrey(file, rows, cols) {
  const bitmap = await createImageBitmap(file);
  const context = new OffscreenCanvas(cols, rows).getContext("2d");
  const scale = Math.min(cols / bitmap.width, rows / bitmap.height);
  const [width, height] = [scale * bitmap.width, scale * bitmap.height];
  context.fillRect(0, 0, cols, rows);
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, (cols - width) / 2, (rows - height) / 2, width, height);
  const { data } = context.getImageData(0, 0, cols, rows), levels = new Uint8Array(rows * cols);
  let coloured = false;
  levels.forEach((_, k) => {
    const [red, green, blue] = data.subarray(4 * k, 4 * k + 3);
    // JPEG moves the channels of grey pixels apart by a few levels.
    coloured ||= Math.max(red, green, blue) - Math.min(red, green, blue) > 8;
    // The weights of the colours in their brightness (ITU-R BT.601).
    levels[k] = Math.round(0.299 * red + 0.587 * green + 0.114 * blue);
  });
  const bars = Math.abs(cols - width) >= 1 || Math.abs(rows - height) >= 1 ? ", with black bars, as its shape differs" : "";
  return { levels, words: `${file.name} (${bitmap.width} \u00d7 ${bitmap.height}) is shown${coloured ? " in grey" : ""} at ${Math.round(width)} \u00d7 ${Math.round(height)}${bars}.` };
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
