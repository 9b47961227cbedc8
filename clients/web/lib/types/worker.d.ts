// A worker's script: new Worker(new URL("@drape/client/worker", import.meta.url), { type: "module" }).
export {};
