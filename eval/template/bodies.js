// Hands and objects as three.js nodes, in metres, out of the arrays that a page holds.
const OBJECT = 0x9ba6b3, SPHERES = 0x7fa88b;

function decode(packed) {
  const text = atob(packed.base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  const values = packed.dtype === "<u4" ? new Uint32Array(bytes.buffer) : new Float32Array(bytes.buffer);
  values.width = packed.shape.length > 1 ? packed.shape.slice(1).reduce((a, b) => a * b) : 1;
  values.row = i => values.subarray(i * values.width, (i + 1) * values.width);
  return values;
}

// Side view of a hull of two spheres, turned about y; x, y, z, radius of each sphere, `origin` is taken off.
function capsuleMesh(c, origin, light) {
  const a = new THREE.Vector3(c[0] - origin[0], c[1] - origin[1], c[2] - origin[2]);
  const b = new THREE.Vector3(c[4] - origin[0], c[5] - origin[1], c[6] - origin[2]);
  const length = a.distanceTo(b);
  const seam = Math.asin(Math.max(-1, Math.min(1, (c[3] - c[7]) / length)));
  const profile = [];
  const arc = (from, to, radius, height) => {
    const parts = light ? 2 : 6;
    for (let i = 0; i <= parts; i++) {
      const angle = from + (to - from) * i / parts;
      profile.push(new THREE.Vector2(Math.max(0, radius * Math.cos(angle)), height + radius * Math.sin(angle)));
    }
  };
  arc(-Math.PI / 2, seam, c[3], 0);
  arc(seam, Math.PI / 2, c[7], length);
  const geometry = new THREE.LatheGeometry(profile, light ? 8 : 20);
  const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.clone().sub(a).normalize());
  return geometry.applyQuaternion(turn).translate(a.x, a.y, a.z);
}

// Kinematics of docs/formats.md as nested nodes: abduction, then flexion, each axis carried by the turns before it.
// `passes` are the materials each part is drawn with, in order; `links` the 16 materials of the first pass, palm first.
function buildHand(shape, passes, light = false) {
  const root = new THREE.Group();
  const joints = decode(shape.joint_m), axes = decode(shape.flexion_axis), abductions = decode(shape.abduction_axis);
  const capsules = decode(shape.capsules_m), palm = decode(shape.palm_spheres_m), tips = decode(shape.tip_m);
  const joint = i => Array.from(joints.subarray(3 * i, 3 * i + 3));
  const vector = (values, i) => new THREE.Vector3(values[3 * i], values[3 * i + 1], values[3 * i + 2]);

  const ball = light ? new THREE.SphereGeometry(1, 7, 5) : new THREE.SphereGeometry(1, 18, 12);
  const links = Array.from({ length: 16 }, () => passes[0].material.clone());
  for (const [k, { material: shared, order }] of passes.entries()) {
    const material = k ? shared : links[0];
    const spheres = new THREE.InstancedMesh(ball, material, palm.length / 4);
    for (let i = 0; i < palm.length / 4; i++) {
      const [x, y, z, r] = palm.row(i);
      spheres.setMatrixAt(i, new THREE.Matrix4().makeScale(r, r, r).setPosition(x, y, z));
    }
    spheres.frustumCulled = false;
    spheres.renderOrder = order;
    root.add(spheres);
  }
  const nodes = [], fingertips = [];
  for (let finger = 0; finger < 5; finger++) {
    let parent = root, before = [0, 0, 0];
    for (let phalanx = 0; phalanx < 3; phalanx++) {
      const i = 3 * finger + phalanx, at = joint(i);
      const node = new THREE.Group();
      node.position.set(at[0] - before[0], at[1] - before[1], at[2] - before[2]);
      const geometry = capsuleMesh(capsules.subarray(8 * i, 8 * i + 8), at, light);
      for (const [k, { material, order }] of passes.entries()) {
        const mesh = new THREE.Mesh(geometry, k ? material : links[1 + i]);
        mesh.renderOrder = order;
        node.add(mesh);
      }
      parent.add(node);
      nodes.push(node);
      [parent, before] = [node, at];
    }
    const tip = new THREE.Object3D();
    tip.position.copy(vector(tips, finger)).sub(new THREE.Vector3(...before));
    parent.add(tip);
    fingertips.push(tip);
  }
  const turn = new THREE.Quaternion();
  function pose(q) {
    root.position.set(q[0], q[1], q[2]);
    root.quaternion.set(q[4], q[5], q[6], q[3]).normalize();
    nodes.forEach((node, i) => {
      node.quaternion.setFromAxisAngle(vector(axes, i), q[7 + i]);
      if (i % 3 === 0) {
        turn.setFromAxisAngle(vector(abductions, i / 3), q[22 + i / 3]);
        node.quaternion.premultiply(turn);
      }
    });
  }
  // Balls as x, y, z, radius and capsules as two of them, in the frame that `into` takes the world to.
  function solids(into) {
    const found = [], frame = new THREE.Matrix4();
    const put = (x, y, z) => new THREE.Vector3(x, y, z).applyMatrix4(frame);
    frame.multiplyMatrices(into, root.matrixWorld);
    for (let i = 0; i < palm.length / 4; i++) {
      const [x, y, z, r] = palm.row(i), at = put(x, y, z);
      found.push([at, r, at, r]);
    }
    nodes.forEach((node, i) => {
      const c = capsules.subarray(8 * i, 8 * i + 8), o = joint(i);
      frame.multiplyMatrices(into, node.matrixWorld);
      found.push([put(c[0] - o[0], c[1] - o[1], c[2] - o[2]), c[3], put(c[4] - o[0], c[5] - o[1], c[6] - o[2]), c[7]]);
    });
    return found;
  }
  return { root, nodes, fingertips, pose, links, solids };
}

// Depth in metres of each of the points inside a hull of two balls, the deepest of all hulls.
function depthInside(points, hulls) {
  const depth = new Float32Array(points.length / 3);
  for (const [a, ra, b, rb] of hulls) {
    const dx = b.x - a.x, dy = b.y - a.y, dz = b.z - a.z, length = Math.hypot(dx, dy, dz);
    const mx = (a.x + b.x) / 2, my = (a.y + b.y) / 2, mz = (a.z + b.z) / 2, reach = (length / 2 + Math.max(ra, rb)) ** 2;
    const sine = length > 0 ? (ra - rb) / length : 0, tangent = sine / Math.sqrt(Math.max(1e-12, 1 - sine * sine));
    for (let i = 0, k = 0; k < points.length; i++, k += 3) {
      const x = points[k], y = points[k + 1], z = points[k + 2];
      if ((x - mx) ** 2 + (y - my) ** 2 + (z - mz) ** 2 > reach) continue;
      const px = x - a.x, py = y - a.y, pz = z - a.z;
      const along = length > 0 ? (px * dx + py * dy + pz * dz) / length : 0;
      const across = Math.sqrt(Math.max(0, px * px + py * py + pz * pz - along * along));
      const s = Math.min(length, Math.max(0, along - across * tangent));
      depth[i] = Math.max(depth[i], ra - s * sine - Math.hypot(along - s, across));
    }
  }
  return depth;
}

// From a colour at depth 0 over orange to dark red at depth 1.
const SHALLOW = new THREE.Color(0xf5a623), DEEP = new THREE.Color(0xa3001e);
function depthColour(into, plain, share) {
  const t = Math.min(1, Math.max(0, share));
  return t < 0.5 ? into.copy(plain).lerp(SHALLOW, 2 * t) : into.copy(SHALLOW).lerp(DEEP, 2 * t - 1);
}

function meshOf(vertices, faces, flat) {
  const indexed = new THREE.BufferGeometry();
  indexed.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
  indexed.setIndex(new THREE.BufferAttribute(faces, 1));
  const geometry = flat ? indexed.toNonIndexed() : indexed;
  geometry.computeVertexNormals();
  const count = geometry.attributes.position.count;
  geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
  // Lambert is lit at the vertices, which software rendering can afford.
  const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: OBJECT }));
  mesh.renderOrder = -1; // before the hand, so that the stencil holds what is seen of it
  return mesh;
}

function buildObject(shape) {
  // A coarse mesh shows its facets: every corner gets a vertex of its own. A dense one is shaded smoothly.
  const faces = decode(shape.faces);
  const solid = meshOf(decode(shape.vertices_m), faces, shape.flat);
  const light = meshOf(decode(shape.light_vertices_m), decode(shape.light_faces), shape.flat);
  light.visible = false;
  const spheres = decode(shape.spheres_m), count = spheres.length / 4;
  // Few triangles each when there are many: software rendering must keep up too.
  const ball = count > 1500 ? new THREE.SphereGeometry(1, 9, 6) : new THREE.SphereGeometry(1, 18, 12);
  const balls = new THREE.InstancedMesh(ball, new THREE.MeshLambertMaterial({ color: SPHERES }), count);
  for (let i = 0; i < count; i++) {
    const [x, y, z, r] = spheres.row(i);
    balls.setMatrixAt(i, new THREE.Matrix4().makeScale(r, r, r).setPosition(x, y, z));
  }
  balls.frustumCulled = false;
  balls.visible = false;
  balls.renderOrder = -1;
  const root = new THREE.Group();
  root.add(solid, light, balls);
  return { root, solid, light, balls };
}
