// usage: node gltf_witness.mjs NODE_MODULES validate|play FILE [SECONDS,SECONDS,…]
// validate: issues that the Khronos validator finds. play: world positions of nodes (the first of each name) that three.js' GLTFLoader
// and AnimationMixer give at these times. Prints JSON. Buffers beside a .gltf are not loaded.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [modules, task, file, times] = process.argv.slice(2);
const bytes = new Uint8Array(readFileSync(file));

if (task === "validate") {
  const validator = createRequire(modules + "/")("gltf-validator");
  const report = await validator.validateBytes(bytes, { maxIssues: 50 });
  console.log(JSON.stringify(report.issues));
} else {
  globalThis.self = globalThis;
  globalThis.ProgressEvent ??= class extends Event {};
  const three = await import(pathToFileURL(`${modules}/three/build/three.module.js`));
  const { GLTFLoader } = await import(pathToFileURL(`${modules}/three/examples/jsm/loaders/GLTFLoader.js`));
  const { scene, animations } = await new GLTFLoader().parseAsync(bytes.buffer, "");
  const mixer = new three.AnimationMixer(scene);
  const action = mixer.clipAction(animations[0]);
  action.setLoop(three.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const place = new three.Vector3();
  const frames = times.split(",").map((seconds) => {
    mixer.setTime(Number(seconds));
    scene.updateMatrixWorld(true);
    const frame = {};
    scene.traverse((node) => {
      frame[node.userData.name ?? node.name] ??= place.setFromMatrixPosition(node.matrixWorld).toArray();
    });
    return frame;
  });
  const skinned = [];
  scene.traverse((node) => node.isSkinnedMesh && skinned.push(node.skeleton.bones.length));
  console.log(JSON.stringify({ frames, skinned, duration: animations[0].duration }));
}
