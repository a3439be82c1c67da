// 3-D replay. Lengths are millimetres on screen, metres in the data: three's controls ignore moves far below 1 unit.
const MM = 1000;
const SKIN = 0xe3ae8c, HAPTIC = 0x2f6fde, FORCE = 0xc8102e, CONTACT = 0x5b1a8c;
const MOST_CONTACTS = 16; // of a frame
// Where the processor draws, what moves is drawn with fewer triangles and half as fine, and whole once it rests.
const LIGHT_SCALE = 0.5, REST_MS = 180;

// One WebGL context draws every run; browsers allow only about sixteen of them.
let renderer = null, software = false;
function sharedRenderer() {
  const probe = renderer === null && new OffscreenCanvas(1, 1).getContext("webgl2");
  if (probe) {
    const named = probe.getExtension("WEBGL_debug_renderer_info");
    software = named && /swiftshader|llvmpipe|software/i.test(probe.getParameter(named.UNMASKED_RENDERER_WEBGL));
    // Smooth edges take twice the time where the processor draws them.
    renderer = new THREE.WebGLRenderer({
      canvas: new OffscreenCanvas(1, 1), antialias: !software, alpha: true, stencil: true,
    });
    renderer.setClearColor(0x000000, 0);
  }
  return renderer;
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
    this.contacts = Object.fromEntries(Object.entries(poses.contacts).map(([name, packed]) => [name, decode(packed)]));
    this.linkDepth = poses.link_depth_mm && decode(poses.link_depth_mm);
    this.depthEnd = poses.depth_end_mm ?? { graphic: 0.1, haptic: 5 };
    this.shown = { graphic: true, haptic: true, forces: true, contacts: true, spheres: false };
    this.coloured = "none";

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
    this.whole = [this.hand, this.ghost];
    this.light = null; // the same two with fewer triangles, made when they are first needed
    this.lightPasses = [{ material: skin, order: 0 }, {
      material: new THREE.MeshLambertMaterial({ color: HAPTIC, transparent: true, opacity: 0.4, ...behind }), order: 3,
    }];
    this.handShape = handShape;
    this.arrows = this.hand.fingertips.map(() => {
      const arrow = new THREE.ArrowHelper(new THREE.Vector3(0, 1, 0), new THREE.Vector3(), 1, FORCE);
      for (const part of [arrow.line, arrow.cone]) {
        part.material.depthTest = false;
        part.renderOrder = 4;
      }
      return arrow;
    });
    const over = { depthTest: false, transparent: true };
    this.dots = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 8, 6), new THREE.MeshBasicMaterial({ color: CONTACT, ...over }), MOST_CONTACTS);
    this.dots.frustumCulled = false;
    this.pushes = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: CONTACT, ...over }));
    this.pushes.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * MOST_CONTACTS), 3));
    this.pushes.frustumCulled = false;
    this.dots.renderOrder = this.pushes.renderOrder = 4;
    this.world = new THREE.Group();
    this.world.scale.setScalar(MM);
    this.world.add(this.object.root, this.hand.root, this.ghost.root);
    this.scene = new THREE.Scene();
    this.scene.add(this.world, ...this.arrows, this.dots, this.pushes, new THREE.HemisphereLight(0xffffff, 0x6b7280, 0.65));
    this.camera = new THREE.PerspectiveCamera(32, 1, 5, 5000);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.55);
    lamp.position.set(-0.4, 0.7, 1);
    this.camera.add(lamp);
    this.scene.add(this.camera);

    this.controls = new THREE.TrackballControls(this.camera, canvas);
    Object.assign(this.controls, { staticMoving: true, rotateSpeed: 2.5, zoomSpeed: 1.2, panSpeed: 0.6 });
    this.pending = false;
    for (const event of ["pointerdown", "pointermove", "pointerup", "wheel"]) {
      canvas.addEventListener(event, () => (event !== "pointermove" || this.dragged) && this.schedule(true));
    }
    canvas.addEventListener("pointerdown", () => { this.dragged = true; });
    window.addEventListener("pointerup", () => { this.dragged = false; });
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

  // `toward` and `share`: part of the way to another frame, for smooth play between poses that are far apart in time.
  show(frame, moving = false, toward = frame, share = 0) {
    this.frame = frame;
    this.posed = [this.graphic, this.haptic].map(of => between(of.row(frame), of.row(toward), share));
    const o = between(this.objectPose.row(frame), this.objectPose.row(toward), share);
    this.object.root.position.set(o[0], o[1], o[2]);
    this.object.root.quaternion.set(o[4], o[5], o[6], o[3]).normalize();
    this.whole.forEach((hand, k) => hand.pose(this.posed[k]));
    this.light?.forEach((hand, k) => hand.pose(this.posed[k]));
    this.schedule(moving);
  }

  placeArrows() {
    const force = this.force.row(this.frame);
    this.scene.updateMatrixWorld();
    this.arrows.forEach((arrow, finger) => {
      const f = new THREE.Vector3(force[3 * finger], force[3 * finger + 1], force[3 * finger + 2]);
      const size = f.length() * this.forceMmPerN;
      arrow.visible = size > 0.2 && this.shown.forces;
      if (!arrow.visible) return;
      this.hand.fingertips[finger].getWorldPosition(arrow.position);
      arrow.setDirection(f.normalize());
      arrow.setLength(size, Math.min(6, 0.4 * size), Math.min(4, 0.25 * size));
    });
  }

  placeContacts() {
    const { start, point_m, force_n } = this.contacts, at = start[this.frame], count = this.shown.contacts ? start[this.frame + 1] - at : 0;
    const ends = this.pushes.geometry.attributes.position, place = new THREE.Matrix4();
    for (let k = 0; k < count; k++) {
      const p = point_m.row(at + k), f = force_n.row(at + k);
      this.dots.setMatrixAt(k, place.makeScale(0.9, 0.9, 0.9).setPosition(MM * p[0], MM * p[1], MM * p[2]));
      ends.setXYZ(2 * k, MM * p[0], MM * p[1], MM * p[2]);
      ends.setXYZ(2 * k + 1, ...[0, 1, 2].map(i => MM * p[i] + this.forceMmPerN * f[i]));
    }
    this.dots.count = count;
    this.dots.instanceMatrix.needsUpdate = ends.needsUpdate = true;
    this.pushes.geometry.setDrawRange(0, 2 * count);
  }

  // What: none, graphic or haptic; how deep the object's surface is inside that hand, and of the graphic hand each link.
  colour(what) {
    this.coloured = what;
    this.schedule();
  }

  paint(hands, mesh) {
    const on = this.coloured !== "none", { material, geometry } = mesh, into = new THREE.Color();
    if (material.vertexColors !== on) {
      material.vertexColors = on;
      material.color.set(on ? 0xffffff : OBJECT);
      material.needsUpdate = true;
    }
    const skin = new THREE.Color(SKIN), depths = this.coloured === "graphic" && this.linkDepth?.row(this.frame);
    hands[0].links.forEach((link, k) => depthColour(link.color, skin, depths ? depths[k] / this.depthEnd.graphic : 0));
    if (!on) return;
    const whole = this.whole[this.coloured === "graphic" ? 0 : 1];
    const depth = depthInside(geometry.attributes.position.array, whole.solids(this.object.root.matrixWorld.clone().invert()));
    const plain = new THREE.Color(OBJECT), colours = geometry.attributes.color, scale = MM / this.depthEnd[this.coloured];
    for (let i = 0; i < depth.length; i++) {
      depthColour(into, plain, depth[i] * scale);
      colours.setXYZ(i, into.r, into.g, into.b);
    }
    colours.needsUpdate = true;
  }

  toggle(what, on) {
    this.shown[what] = on;
    this.schedule();
  }

  // Shows the parts of one detail; gives the hands and the object's mesh of it.
  choose(light) {
    if (light && !this.light) {
      this.light = this.lightPasses.map(pass => buildHand(this.handShape, [pass], true));
      this.light.forEach((hand, k) => hand.pose(this.posed[k]));
      this.world.add(...this.light.map(hand => hand.root));
    }
    const hands = light ? this.light : this.whole;
    for (const [other, of] of [[!light, this.whole], [light, this.light]]) {
      of?.forEach((hand, k) => { hand.root.visible = other && (k ? this.shown.haptic && this.coloured === "none" : this.shown.graphic); });
    }
    const { solid, light: few, balls } = this.object;
    balls.visible = this.shown.spheres && !light;
    solid.visible = !this.shown.spheres && !light;
    few.visible = light;
    return [hands, light ? few : solid];
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

  schedule(moving = false) {
    this.moving = moving && software;
    clearTimeout(this.rest);
    if (this.moving) this.rest = setTimeout(() => this.schedule(), REST_MS);
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.draw(this.moving);
    });
  }

  draw(light = false) {
    const drawn = sharedRenderer(), scale = light ? LIGHT_SCALE : 1;
    const width = Math.max(1, Math.round(this.width * scale)), height = Math.max(1, Math.round(this.height * scale));
    this.controls.update();
    const [hands, mesh] = this.choose(light);
    this.placeArrows();
    this.placeContacts();
    this.paint(hands, mesh);
    if (drawn.domElement.width !== width || drawn.domElement.height !== height) drawn.setSize(width, height, false);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    drawn.render(this.scene, this.camera);
    this.picture.transferFromImageBitmap(drawn.domElement.transferToImageBitmap());
  }
}

function between(a, b, share) {
  return share ? a.map((value, k) => value + share * (b[k] - value)) : a;
}
