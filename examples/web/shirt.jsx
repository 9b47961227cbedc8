"use client";
// The same in React Three Fiber, as a page of Next: npm install @drape/client three @react-three/fiber.
import { Canvas } from "@react-three/fiber";
import { Garment } from "@drape/client/react";
import { useEffect, useState } from "react";

export default function Page() {
  const [service, setService] = useState(null); // the address is the browser's
  useEffect(() => setService(new URLSearchParams(location.search).get("service") ?? "http://127.0.0.1:8000"), []);
  const counted = ({ target }) => (document.body.dataset.frames = target.stats.frames);
  return (
    <Canvas style={{ height: "100vh", background: "#e9e5de" }} camera={{ fov: 35, position: [0, 1, 3.5], rotation: [0, 0, 0] }}>
      <hemisphereLight args={[0xffffff, 0x8d8478, 3]} />
      {service && <Garment service={service} garments="tshirt" tier="fast" body folds_by="client" colours={["#2f6fb0"]} play="stretch" onFrame={counted} />}
    </Canvas>
  );
}
