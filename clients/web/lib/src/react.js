// A garment that is worn for as long as a component is there: a hook, and a component of React Three Fiber.
import { createElement, useEffect, useState } from "react";
import { connect } from "./index.js";

const services = new Map(); // by address, each asked once

function serviceAt(url, access) {
  if (!services.has(url)) {
    const opened = connect(url, access);
    opened.catch(() => services.delete(url));
    services.set(url, opened);
  }
  return services.get(url);
}

// { garment, error }: the object for <primitive object={garment} />, null until it is there. options: those of wear(),
// play, the name of a motion, and access, what connect() takes.
export function useGarment(url, garments, { play, access, ...options } = {}) {
  const [worn, setWorn] = useState({ garment: null, error: null });
  const asked = JSON.stringify([url, garments, options]); // the same words are the same garment
  useEffect(() => {
    let left = false;
    let garment = null;
    const [, names, wanted] = JSON.parse(asked);
    serviceAt(url, access)
      .then((drape) => drape.wear(names, wanted))
      .then((made) => {
        garment = made;
        if (left) garment.dispose();
        else setWorn({ garment, error: null });
      })
      .catch((error) => left || setWorn({ garment: null, error }));
    return () => {
      left = true;
      garment?.dispose();
      setWorn({ garment: null, error: null });
    };
  }, [asked]);
  useEffect(() => {
    if (play) worn.garment?.play(play).catch((error) => setWorn((now) => ({ ...now, error })));
    else worn.garment?.stop();
  }, [worn.garment, play]);
  return worn;
}

// Within the Canvas of @react-three/fiber: what useGarment() wears. onFrame(event): a frame is shown; an error is thrown to
// the nearest error boundary. All else are its options.
export function Garment({ service, garments, onFrame, ...options }) {
  const { garment, error } = useGarment(service, garments, options);
  useEffect(() => {
    if (!garment || !onFrame) return undefined;
    garment.addEventListener("frame", onFrame);
    return () => garment.removeEventListener("frame", onFrame);
  }, [garment, onFrame]);
  if (error) throw error;
  return garment && createElement("primitive", { object: garment });
}
