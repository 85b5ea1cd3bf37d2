// Runs the Khronos validator over glTF files and loads them with three.js's GLTFLoader.
//
//     npm ci && node check.mjs FILE.glb FILE.gltf ...
//
// Prints one JSON object a file: the validator's counts and messages, and the lines that
// three.js made, in world coordinates. Exit code 1 when a file has an issue of any severity.
import { readFile } from 'node:fs/promises';
import { basename } from 'node:path';
import { validateBytes, version } from 'gltf-validator';
import { Line, LineLoop, LineSegments, Vector3 } from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

// The browser has it; three.js's loader reports the progress of data: URIs with it.
globalThis.ProgressEvent ??= class extends Event {};

async function validate(bytes, name) {
  const { issues } = await validateBytes(bytes, { uri: name, maxIssues: 100 });
  const { numErrors, numWarnings, numInfos, numHints, messages } = issues;
  return { numErrors, numWarnings, numInfos, numHints, messages };
}

async function load(bytes) {
  const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
  const { scene } = await new GLTFLoader().parseAsync(buffer, '');
  scene.updateMatrixWorld(true);
  const lines = [];
  const extras = [];
  scene.traverse((object) => {
    if (object.userData.nodes) extras.push(object.userData);
    if (!(object instanceof Line) || object instanceof LineLoop || object instanceof LineSegments) return;
    const { position, _radius: radius } = object.geometry.attributes;
    const world = (place) => new Vector3().fromBufferAttribute(position, place).applyMatrix4(object.matrixWorld).toArray();
    lines.push({
      extras: object.geometry.userData,
      points: position.count,
      first: world(0),
      last: world(position.count - 1),
      radii: Array.from({ length: radius.count }, (_, place) => radius.getX(place)),
    });
  });
  return { lines, extras };
}

let clean = true;
for (const path of process.argv.slice(2)) {
  const bytes = new Uint8Array(await readFile(path));
  const report = await validate(bytes, basename(path));
  clean &&= report.numErrors + report.numWarnings + report.numInfos + report.numHints === 0;
  console.log(JSON.stringify({ file: basename(path), validator: version(), ...report, three: await load(bytes) }));
}
process.exitCode = clean ? 0 : 1;
