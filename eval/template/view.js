// 3-D replay. Lengths are millimetres on screen, metres in the data: three's controls ignore moves far below 1 unit.
const MM = 1000;
const SMOOTH_ABOVE_FACES = 8000;
const SKIN = 0xe3ae8c, HAPTIC = 0x2f6fde, OBJECT = 0x9ba6b3, SPHERES = 0x7fa88b, FORCE = 0xc8102e;

function decode(packed) {
  const bytes = Uint8Array.from(atob(packed.base64), c => c.charCodeAt(0));
  const values = packed.dtype === "<u4" ? new Uint32Array(bytes.buffer) : new Float32Array(bytes.buffer);
  values.width = packed.shape.length > 1 ? packed.shape.slice(1).reduce((a, b) => a * b) : 1;
  values.row = i => values.subarray(i * values.width, (i + 1) * values.width);
  return values;
}

// One WebGL context draws every run; browsers allow only about sixteen of them.
let renderer = null;
function sharedRenderer() {
  const probe = renderer === null && new OffscreenCanvas(1, 1).getContext("webgl2");
  if (probe) {
    const named = probe.getExtension("WEBGL_debug_renderer_info");
    const software = named && /swiftshader|llvmpipe|software/i.test(probe.getParameter(named.UNMASKED_RENDERER_WEBGL));
    // Smooth edges take twice the time where the processor draws them.
    renderer = new THREE.WebGLRenderer({
      canvas: new OffscreenCanvas(1, 1), antialias: !software, alpha: true, stencil: true,
    });
    renderer.setClearColor(0x000000, 0);
  }
  return renderer;
}

// Side view of a hull of two spheres, turned about y; x, y, z, radius of each sphere, `origin` is taken off.
function capsuleMesh(c, origin) {
  const a = new THREE.Vector3(c[0] - origin[0], c[1] - origin[1], c[2] - origin[2]);
  const b = new THREE.Vector3(c[4] - origin[0], c[5] - origin[1], c[6] - origin[2]);
  const length = a.distanceTo(b);
  const seam = Math.asin(Math.max(-1, Math.min(1, (c[3] - c[7]) / length)));
  const profile = [];
  const arc = (from, to, radius, height) => {
    for (let i = 0; i <= 6; i++) {
      const angle = from + (to - from) * i / 6;
      profile.push(new THREE.Vector2(Math.max(0, radius * Math.cos(angle)), height + radius * Math.sin(angle)));
    }
  };
  arc(-Math.PI / 2, seam, c[3], 0);
  arc(seam, Math.PI / 2, c[7], length);
  const geometry = new THREE.LatheGeometry(profile, 20);
  const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.clone().sub(a).normalize());
  return geometry.applyQuaternion(turn).translate(a.x, a.y, a.z);
}

// Kinematics of docs/formats.md as nested nodes: abduction, then flexion, each axis carried by the turns before it.
// `passes` are the materials each part is drawn with, in order.
function buildHand(shape, passes) {
  const root = new THREE.Group();
  const joints = decode(shape.joint_m), axes = decode(shape.flexion_axis), abductions = decode(shape.abduction_axis);
  const capsules = decode(shape.capsules_m), palm = decode(shape.palm_spheres_m), tips = decode(shape.tip_m);
  const joint = i => Array.from(joints.subarray(3 * i, 3 * i + 3));
  const vector = (values, i) => new THREE.Vector3(values[3 * i], values[3 * i + 1], values[3 * i + 2]);

  const ball = new THREE.SphereGeometry(1, 18, 12);
  for (const { material, order } of passes) {
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
      const geometry = capsuleMesh(capsules.subarray(8 * i, 8 * i + 8), at);
      for (const { material, order } of passes) {
        const mesh = new THREE.Mesh(geometry, material);
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
    root.quaternion.set(q[4], q[5], q[6], q[3]);
    nodes.forEach((node, i) => {
      node.quaternion.setFromAxisAngle(vector(axes, i), q[7 + i]);
      if (i % 3 === 0) {
        turn.setFromAxisAngle(vector(abductions, i / 3), q[22 + i / 3]);
        node.quaternion.premultiply(turn);
      }
    });
  }
  return { root, nodes, fingertips, pose };
}

function buildObject(shape) {
  const indexed = new THREE.BufferGeometry();
  indexed.setAttribute("position", new THREE.BufferAttribute(decode(shape.vertices_m), 3));
  indexed.setIndex(new THREE.BufferAttribute(decode(shape.faces), 1));
  // A coarse mesh shows its facets: every corner gets a vertex of its own. A dense one is shaded smoothly.
  const mesh = indexed.index.count < 3 * SMOOTH_ABOVE_FACES ? indexed.toNonIndexed() : indexed;
  mesh.computeVertexNormals();
  // Lambert is lit at the vertices, which software rendering can afford.
  const solid = new THREE.Mesh(mesh, new THREE.MeshLambertMaterial({ color: OBJECT }));
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
  solid.renderOrder = balls.renderOrder = -1; // before the hand, so that the stencil holds what is seen of it
  const root = new THREE.Group();
  root.add(solid, balls);
  return { root, solid, balls };
}

class View {
  constructor(canvas, poses, handShape, objectShape, first, forceMmPerN) {
    this.forceMmPerN = forceMmPerN;
    this.canvas = canvas;
    this.picture = canvas.getContext("bitmaprenderer");
    this.graphic = decode(poses.graphic);
    this.haptic = decode(poses.haptic);
    this.objectPose = decode(poses.object);
    this.force = decode(poses.fingertip_force_n);

    // The haptic hand: where the object hides it, a flat tint, once a pixel and never over the graphic hand (stencil 2);
    // elsewhere first its depth alone, then its front surface, pushed back a little so that the graphic hand wins where
    // both agree.
    const skin = new THREE.MeshLambertMaterial({
      color: SKIN,
      stencilWrite: true, stencilFunc: THREE.AlwaysStencilFunc, stencilRef: 2, stencilZPass: THREE.ReplaceStencilOp,
    });
    const behind = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2 };
    const tint = new THREE.MeshBasicMaterial({
      color: HAPTIC, transparent: true, opacity: 0.28, depthFunc: THREE.GreaterDepth, depthWrite: false,
      stencilWrite: true, stencilFunc: THREE.EqualStencilFunc, stencilRef: 0, stencilZPass: THREE.IncrementStencilOp,
    });
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false, ...behind });
    const front = new THREE.MeshLambertMaterial({
      color: HAPTIC, transparent: true, opacity: 0.5, depthFunc: THREE.LessEqualDepth, ...behind,
    });
    depth.transparent = true; // drawn after everything opaque
    this.hand = buildHand(handShape, [{ material: skin, order: 0 }]);
    this.ghost = buildHand(handShape, [
      { material: tint, order: 1 }, { material: depth, order: 2 }, { material: front, order: 3 },
    ]);
    this.object = buildObject(objectShape);
    this.arrows = this.hand.fingertips.map(() => {
      const arrow = new THREE.ArrowHelper(new THREE.Vector3(0, 1, 0), new THREE.Vector3(), 1, FORCE);
      for (const part of [arrow.line, arrow.cone]) {
        part.material.depthTest = false;
        part.renderOrder = 4;
      }
      return arrow;
    });
    this.world = new THREE.Group();
    this.world.scale.setScalar(MM);
    this.world.add(this.object.root, this.hand.root, this.ghost.root);
    this.scene = new THREE.Scene();
    this.scene.add(this.world, ...this.arrows, new THREE.HemisphereLight(0xffffff, 0x6b7280, 0.65));
    this.camera = new THREE.PerspectiveCamera(32, 1, 5, 5000);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.55);
    lamp.position.set(-0.4, 0.7, 1);
    this.camera.add(lamp);
    this.scene.add(this.camera);

    this.controls = new THREE.TrackballControls(this.camera, canvas);
    Object.assign(this.controls, { staticMoving: true, rotateSpeed: 2.5, zoomSpeed: 1.2, panSpeed: 0.6 });
    this.pending = false;
    for (const event of ["pointerdown", "pointermove", "pointerup", "wheel"]) {
      canvas.addEventListener(event, () => this.schedule());
    }
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.show(first);
    this.resize();
    this.look();
  }

  // From the thumb's side, a little above the back of the hand: the profile of the grasp.
  look() {
    this.scene.updateMatrixWorld(true);
    const place = node => node.getWorldPosition(new THREE.Vector3());
    const [index, little] = [place(this.hand.nodes[3]), place(this.hand.nodes[12])];
    const radial = index.clone().sub(little).normalize();
    const wrist = place(this.hand.root);
    const distal = place(this.hand.nodes[6]).sub(wrist).normalize();
    const axis = new THREE.Vector3().crossVectors(radial, distal).normalize();
    const palmar = place(this.hand.fingertips[2]).sub(place(this.hand.nodes[6]));
    const dorsal = palmar.dot(axis) > 0 ? axis.negate() : axis;
    const box = new THREE.Box3().setFromObject(this.object.solid);
    for (const node of [this.hand.root, ...this.hand.fingertips]) box.expandByPoint(place(node));
    const ball = box.getBoundingSphere(new THREE.Sphere());
    const from = radial.multiplyScalar(0.85).addScaledVector(dorsal, 0.45).addScaledVector(distal, 0.35).normalize();
    this.camera.up.copy(dorsal);
    this.camera.position.copy(ball.center).addScaledVector(from, ball.radius * 3.4);
    this.controls.target.copy(ball.center);
    this.schedule();
  }

  show(frame) {
    this.frame = frame;
    this.hand.pose(this.graphic.row(frame));
    this.ghost.pose(this.haptic.row(frame));
    const o = this.objectPose.row(frame);
    this.object.root.position.set(o[0], o[1], o[2]);
    this.object.root.quaternion.set(o[4], o[5], o[6], o[3]);
    this.schedule();
  }

  placeArrows() {
    const force = this.force.row(this.frame);
    this.scene.updateMatrixWorld();
    this.arrows.forEach((arrow, finger) => {
      const f = new THREE.Vector3(force[3 * finger], force[3 * finger + 1], force[3 * finger + 2]);
      const size = f.length() * this.forceMmPerN;
      arrow.visible = size > 0.2 && !this.withoutForces;
      if (!arrow.visible) return;
      this.hand.fingertips[finger].getWorldPosition(arrow.position);
      arrow.setDirection(f.normalize());
      arrow.setLength(size, Math.min(6, 0.4 * size), Math.min(4, 0.25 * size));
    });
  }

  toggle(what, on) {
    if (what === "spheres") {
      this.object.balls.visible = on;
      this.object.solid.visible = !on;
    } else if (what === "haptic") {
      this.ghost.root.visible = on;
    } else if (what === "graphic") {
      this.hand.root.visible = on;
    } else {
      this.withoutForces = !on;
    }
    this.schedule();
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio, 2);
    this.width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    this.height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    this.camera.aspect = this.width / this.height;
    this.camera.updateProjectionMatrix();
    this.controls.handleResize();
    this.schedule();
  }

  schedule() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.draw();
    });
  }

  draw() {
    const { width, height } = this, drawn = sharedRenderer();
    this.controls.update();
    this.placeArrows();
    if (drawn.domElement.width !== width || drawn.domElement.height !== height) drawn.setSize(width, height, false);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    drawn.render(this.scene, this.camera);
    this.picture.transferFromImageBitmap(drawn.domElement.transferToImageBitmap());
  }
}
