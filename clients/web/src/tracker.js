// The frame in which a user's own tracker runs: its origin is nobody's, and its policy lets it reach nothing. Pictures of
// the camera come in, points go out. build.mjs puts it into the document: of an origin of nobody's it could fetch no file.
(() => {
  const picture = document.createElement("canvas");
  picture.videoWidth = picture.videoHeight = 0; // what a tracker asks a video for
  Object.assign(picture.style, { position: "fixed", inset: "0", width: "100%", height: "100%", objectFit: "cover", transform: "scaleX(-1)" });
  document.body.append(picture);
  const tell = (message) => parent.postMessage(message, "*"); // an origin of nobody's knows no other
  let begun = null;
  const first = new Promise((resolve) => (begun = resolve));

  // files: names and bytes of what the user chose. One is a module with track(video, put, files): the addresses by name.
  async function load(files) {
    const kinds = { js: "text/javascript", mjs: "text/javascript", wasm: "application/wasm" };
    const made = files.map(({ name, bytes }) => {
      const type = kinds[name.split(".").pop().toLowerCase()] ?? "application/octet-stream";
      return [name, URL.createObjectURL(new Blob([bytes], { type }))];
    });
    const addresses = Object.fromEntries(made);
    const modules = made.filter(([name]) => /\.m?js$/i.test(name)).sort(([a], [b]) => /^tracker\./.test(b) - /^tracker\./.test(a));
    let failure = null;
    for (const [name, address] of modules) {
      try {
        const { track } = await import(address);
        if (typeof track === "function") return (put) => track(picture, put, addresses);
      } catch (error) {
        failure ??= new Error(`${name}: ${error.message}`);
      }
    }
    throw failure ?? new Error(`expected a module with a function track(video, put), got ${files.map(({ name }) => name).join(", ") || "nothing"}.`);
  }

  addEventListener("message", async ({ data, source }) => {
    if (source !== parent) return;
    if (data.picture) {
      const { width, height } = data.picture;
      if (picture.width !== width || picture.height !== height) Object.assign(picture, { width, height });
      picture.videoWidth = width;
      picture.videoHeight = height;
      picture.getContext("2d").drawImage(data.picture, 0, 0);
      data.picture.close();
      begun();
      tell({ seen: true });
    }
    if (!data.files) return;
    try {
      const track = await load(data.files);
      tell({ loaded: true });
      await first;
      await track((points, visibility) => tell({ points: Array.from(points, plain), visibility: visibility && Array.from(visibility) }));
    } catch (error) {
      tell({ failed: error.message });
    }
  });

  // A point as it can be sent: numbers, or an object of numbers.
  const plain = (point) => (Array.isArray(point) || ArrayBuffer.isView(point) ? Array.from(point) : { x: point.x, y: point.y, z: point.z, visibility: point.visibility });
  tell({ ready: true });
})();
