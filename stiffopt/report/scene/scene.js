// Motion of an arm: bent, planned, and the ghost of a baseline; sliders for time and magnification.
// The address may set the state: report.html#time=0.3&factor=200&part=total&ghost=0.
"use strict";
// The plots with a time cursor follow below.
document.addEventListener("DOMContentLoaded", () => {
  const root = document.getElementById("scene");
  const scene = JSON.parse(document.getElementById("scene-document").textContent);
  const role = (name) => root.querySelector(`[data-role="${name}"]`);
  const BLUE = 0x0072b2, VERMILLION = 0xd55e00, GREY = 0x8a929c;
  const {Vector3, Matrix4, Quaternion} = THREE;
  const count = scene.joints.length;
  const vector = (values) => new Vector3(...values);
  const matrix = (rotation, offset) => new Matrix4().set(
    ...rotation[0], offset[0], ...rotation[1], offset[1], ...rotation[2], offset[2], 0, 0, 0, 1);
  const fixed = scene.joints.map((joint) => matrix(joint.rotation, joint.translation));
  const axes = scene.joints.map((joint) => vector(joint.axis));
  const offset = vector(scene.tool.offset);

  // Frames of the base and of all joints at positions q.
  function frames(q) {
    const found = [new Matrix4()];
    scene.joints.forEach((joint, j) => {
      const own = joint.prismatic
        ? new Matrix4().makeTranslation(...axes[j].clone().multiplyScalar(q[j]).toArray())
        : new Matrix4().makeRotationAxis(axes[j], q[j]);
      found.push(found[joint.parent].clone().multiply(fixed[j]).multiply(own));
    });
    return found;
  }
  const toolAt = (placed) => offset.clone().applyMatrix4(placed[scene.tool.joint]);

  // Values of a motion between its frames.
  function at(motion, rows, time) {
    const times = motion.time, last = times.length - 1;
    let k = 0, high = last;
    while (high - k > 1) { const middle = (k + high) >> 1; if (times[middle] <= time) k = middle; else high = middle; }
    const step = times[k + 1] - times[k] || 1;
    const share = Math.min(Math.max((time - times[k]) / step, 0), 1);
    const mix = (a, b) => a + share * (b - a);
    return Array.isArray(rows[k]) ? rows[k].map((a, j) => mix(a, rows[k + 1][j])) : mix(rows[k], rows[k + 1]);
  }
  const bent = (motion, time, part, factor) => {
    const bend = part ? at(motion, motion.bend[part], time) : null;
    return at(motion, motion.position, time).map((q, j) => q - (bend ? factor * bend[j] : 0));
  };

  function decoded(text, step, origin) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const numbers = new Uint16Array(bytes.buffer);
    return step === undefined ? Array.from(numbers)
      : Float32Array.from(numbers, (value, k) => origin[k % 3] + step * value);
  }
  // The axis of capsule geometry is y.
  function along(mesh, begin, end) {
    const direction = end.clone().sub(begin);
    mesh.position.copy(begin).addScaledVector(direction, 0.5);
    mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), direction.normalize());
    return mesh;
  }
  function shapeOf(shape, material) {
    if (shape.kind === "capsule") {
      const begin = vector(shape.begin), end = vector(shape.end);
      const geometry = new THREE.CapsuleGeometry(shape.radius, begin.distanceTo(end), 6, 20);
      return along(new THREE.Mesh(geometry, material), begin, end);
    }
    let geometry;
    const turned = new Matrix4();
    if (shape.kind === "box") geometry = new THREE.BoxGeometry(...shape.size);
    else if (shape.kind === "sphere") geometry = new THREE.SphereGeometry(shape.size[0], 24, 16);
    else if (shape.kind === "cylinder") {
      geometry = new THREE.CylinderGeometry(shape.size[0], shape.size[0], shape.size[1], 32);
      turned.makeRotationX(Math.PI / 2);
    } else {
      geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(decoded(shape.vertices, shape.step, shape.origin), 3));
      geometry.setIndex(decoded(shape.triangles));
      geometry = geometry.toNonIndexed();
      geometry.computeVertexNormals();
    }
    const mesh = new THREE.Mesh(geometry, material);
    mesh.applyMatrix4(matrix(shape.rotation, shape.offset).multiply(turned));
    return mesh;
  }

  const world = new THREE.Scene();
  class Arm {
    constructor(material, jointMaterial) {
      this.groups = [...Array(count + 1)].map(() => new THREE.Group());
      this.groups.forEach((group) => { group.matrixAutoUpdate = false; world.add(group); });
      for (const shape of scene.shapes) this.groups[shape.joint].add(shapeOf(shape, material));
      const drawn = scene.shapes.some((shape) => shape.kind !== "capsule");
      this.joints = scene.joints.map((joint, j) => {
        const own = jointMaterial();
        const radius = joint.radius * (drawn ? 1.5 : 1.25), length = joint.radius * (drawn ? 0.5 : 2.2);
        const mesh = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, length, 32), own);
        mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), axes[j]);
        this.groups[j + 1].add(mesh);
        return own;
      });
    }
    place(placed) { this.groups.forEach((group, k) => { group.matrix.copy(placed[k]); group.matrixWorldNeedsUpdate = true; }); }
    show(visible) { this.groups.forEach((group) => { group.visible = visible; }); }
  }
  const solid = (color) => new THREE.MeshLambertMaterial({color, side: THREE.DoubleSide});
  // Drawn behind the arm where they overlap it.
  const clear = (color, opacity) => new THREE.MeshLambertMaterial({color, opacity, transparent: true,
    depthWrite: false, polygonOffset: true, polygonOffsetFactor: 4, polygonOffsetUnits: 4});
  const plannedMaterial = clear(BLUE, 0.16), ghostMaterial = clear(GREY, 0.16);
  const arm = new Arm(solid(0xc9ced6), () => solid(0xffffff));
  const planned = new Arm(plannedMaterial, () => plannedMaterial);
  for (const each of scene.around) world.add(shapeOf(each, clear(GREY, each.kind === "box" && each.size[2] < 0.005 ? 0.2 : 0.45)));
  const [motion, baseline] = scene.motions;
  const ghost = baseline ? new Arm(ghostMaterial, () => ghostMaterial) : null;

  const line = (color) => {
    const drawn = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({color}));
    world.add(drawn);
    return drawn;
  };
  const trace = (drawn, points) => { drawn.geometry.dispose(); drawn.geometry = new THREE.BufferGeometry().setFromPoints(points); };
  const path = (of, part, factor) => of.time.map((time) => toolAt(frames(bent(of, time, part, factor))));
  const plannedLine = line(BLUE), bentLine = line(VERMILLION), ghostLine = ghost ? line(GREY) : null;
  const plannedPath = path(motion, "", 0);
  trace(plannedLine, plannedPath);
  const ghostPath = ghost ? path(baseline, "", 0) : [];
  if (ghost) trace(ghostLine, ghostPath);
  const extent = scene.joints.reduce((sum, joint) => sum + vector(joint.translation).length(), offset.length());
  const ball = new THREE.Mesh(new THREE.SphereGeometry(0.012 * extent, 20, 14), solid(VERMILLION));
  world.add(ball);
  const floor = new THREE.GridHelper(2.4 * extent, 12, GREY, GREY);
  floor.rotation.x = Math.PI / 2;
  floor.material.transparent = true;
  floor.material.opacity = 0.25;
  world.add(floor, new THREE.HemisphereLight(0xffffff, 0x777777, 2.2));
  const sun = new THREE.DirectionalLight(0xffffff, 1.6);
  sun.position.set(2, -3, 5);
  world.add(sun);

  const canvas = root.querySelector("canvas");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({canvas, antialias: true, alpha: true});
  } catch {
    // Without WebGL only the still picture is shown.
    root.remove();
    return;
  }
  root.hidden = false;
  const camera = new THREE.PerspectiveCamera(35, 1, 0.01 * extent, 30 * extent);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, canvas);
  // The wheel scrolls the page until the scene is clicked.
  controls.enableZoom = false;
  canvas.addEventListener("pointerdown", () => { controls.enableZoom = true; });
  canvas.addEventListener("pointerleave", () => { controls.enableZoom = false; });
  // Fit all poses and both paths, seen from the side of the tool.
  const points = [...plannedPath];
  motion.time.forEach((time, k) => { if (k % 10 === 0) for (const placed of frames(at(motion, motion.position, time))) points.push(new Vector3().setFromMatrixPosition(placed)); });
  points.push(...ghostPath);
  const low = points.reduce((a, b) => a.clone().min(b)), high = points.reduce((a, b) => a.clone().max(b));
  const centre = low.clone().add(high).multiplyScalar(0.5);
  const towards = plannedPath[0].clone().add(plannedPath[plannedPath.length - 1]).multiplyScalar(0.5).sub(points[plannedPath.length]).setZ(0);
  if (towards.length() < 1e-6) towards.set(1, 0, 0);
  const view = towards.normalize().applyAxisAngle(new Vector3(0, 0, 1), -0.9).setZ(0.45).normalize();
  function frame() {
    const width = canvas.parentElement.clientWidth, height = canvas.parentElement.clientHeight;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    // As near as possible with every point in view, plus space for the links.
    const tall = Math.tan((camera.fov / 2) * Math.PI / 180), wide = tall * camera.aspect, room = 0.08 * extent;
    const right = camera.up.clone().cross(view).normalize(), above = view.clone().cross(right);
    const distance = points.reduce((far, point) => {
      const from = point.clone().sub(centre);
      const needed = Math.max((Math.abs(from.dot(right)) + room) / wide, (Math.abs(from.dot(above)) + room) / tall);
      return Math.max(far, from.dot(view) + needed);
    }, room);
    controls.target.copy(centre);
    camera.position.copy(centre).addScaledVector(view, distance);
    controls.update();
  }

  // Time axes of plots: [left, top, right, bottom, first, last] in SVG units.
  const cursors = [];
  const duration = motion.time[motion.time.length - 1];
  document.querySelectorAll("svg[data-times]").forEach((svg) => {
    for (const [left, top, right, bottom, first, last] of JSON.parse(svg.dataset.times)) {
      const cursor = document.createElementNS("http://www.w3.org/2000/svg", "line");
      for (const [name, value] of Object.entries({y1: top, y2: bottom, stroke: "#d55e00", "stroke-width": 1.2, "pointer-events": "none", class: "cursor"})) cursor.setAttribute(name, value);
      svg.append(cursor);
      cursors.push((time) => {
        const x = left + (right - left) * (time - first) / (last - first);
        cursor.setAttribute("x1", x); cursor.setAttribute("x2", x);
      });
    }
    svg.style.cursor = "crosshair";
    svg.addEventListener("click", (event) => {
      const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      for (const [left, top, right, bottom, first, last] of JSON.parse(svg.dataset.times)) {
        if (place.x < left || place.x > right || place.y < top || place.y > bottom) continue;
        set("time", 1000 * (first + (last - first) * (place.x - left) / (right - left)) / duration);
      }
    });
  });

  // Magnification: off at 0, else 1 to 10000 on a logarithmic scale.
  const factorOf = (value) => (value <= 0 ? 0 : 10 ** (4 * (value - 1) / 99));
  const valueOf = (factor) => (factor < 1 ? 0 : 1 + 99 * Math.log10(Math.min(factor, 1e4)) / 4);
  const digits = (value, n) => Number(value.toPrecision(n)).toLocaleString("en", {maximumFractionDigits: 6, useGrouping: false});
  const small = (metres) => (Math.abs(metres) < 1e-4 ? `${digits(1e6 * metres, 3)} µm` : `${digits(1e3 * metres, 3)} mm`);
  const percent = (share) => `${Math.round(100 * share) || 0} %`.replace("-", "−");
  // Full red from a share of one half on.
  const heat = (share) => new THREE.Color().lerpColors(
    new THREE.Color(0xf2f4f6), new THREE.Color(VERMILLION), Math.min(Math.max(2 * share, 0), 1));
  const bars = scene.joints.map((joint) => {
    const bar = document.createElement("div");
    bar.innerHTML = "<span></span><i></i><b></b>";
    bar.firstChild.textContent = joint.label;
    root.querySelector(".shares").append(bar);
    return bar;
  });

  let bentKey = "";
  function draw() {
    const time = duration * role("time").value / 1000;
    const factor = factorOf(Number(role("factor").value)), part = role("part").value;
    const placed = frames(bent(motion, time, part, factor));
    arm.place(placed);
    planned.place(frames(at(motion, motion.position, time)));
    planned.show(role("planned").checked && factor > 0);
    if (ghost) {
      ghost.place(frames(at(baseline, baseline.position, time)));
      ghost.show(role("ghost").checked);
      ghostLine.visible = role("ghost").checked;
    }
    const key = `${part} ${factor}`;
    if (key !== bentKey) trace(bentLine, path(motion, part, factor));
    bentKey = key;
    bentLine.visible = factor > 0;
    const tool = toolAt(placed);
    ball.position.copy(tool);
    const shares = part ? at(motion, motion.share[part], time) : [];
    const size = part ? at(motion, motion.deflection[part], time) : 0;
    scene.joints.forEach((_, j) => {
      const share = shares[j] ?? 0, colour = heat(share);
      arm.joints[j].color.copy(colour);
      bars[j].children[1].style.width = `${Math.round(100 * Math.min(Math.max(share, 0), 1))}%`;
      bars[j].children[1].style.background = `#${colour.getHexString()}`;
      bars[j].children[2].textContent = percent(share);
    });
    role("time-shown").textContent = `${time.toFixed(3)} s`;
    role("factor-shown").textContent = factor > 0 ? `× ${digits(factor, 2)}` : "off";
    role("deflection").textContent = part ? `${part} deflection of the tool ${small(size)}` : "";
    for (const move of cursors) move(time);
    // For tests: displayed position of the tool.
    root.dataset.tool = tool.toArray().map((x) => x.toFixed(5)).join(" ");
    renderer.render(world, camera);
  }
  let waiting = false;
  const soon = () => { if (!waiting) { waiting = true; requestAnimationFrame(() => { waiting = false; draw(); }); } };
  function set(name, value) {
    const input = role(name);
    if (input.type === "checkbox") input.checked = value !== "0" && value !== false;
    else input.value = value;
    input.dispatchEvent(new Event("input", {bubbles: true}));
  }

  for (const part of scene.parts) role("part").append(new Option(part, part));
  role("part").value = scene.part;
  role("factor").value = valueOf(scene.factor);
  if (!scene.parts.length) for (const name of ["factor", "part"]) role(name).closest("label").remove();
  if (ghost) role("ghost-label").querySelector("span").textContent = `ghost: ${baseline.name}`;
  else role("ghost-label").hidden = true;
  // Start at the largest deflection.
  if (scene.part) {
    const sizes = motion.deflection[scene.part];
    role("time").value = 1000 * motion.time[sizes.indexOf(Math.max(...sizes))] / duration;
  }
  root.addEventListener("input", soon);
  controls.addEventListener("change", soon);
  // Draw immediately: a resized canvas is empty.
  new ResizeObserver(() => { frame(); draw(); }).observe(canvas.parentElement);

  let playing = 0;
  role("play").addEventListener("click", () => {
    playing = playing ? 0 : performance.now();
    role("play").textContent = playing ? "❚❚" : "▶";
    const begin = Number(role("time").value) % 1000;
    // Play a motion in at least two seconds.
    const long = 1000 * Math.max(duration, 2);
    const step = (now) => {
      if (!playing) return;
      set("time", (begin + 1000 * (now - playing) / long) % 1000);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  });
  for (const [name, value] of new URLSearchParams(location.hash.slice(1))) {
    if (name === "time") set("time", 1000 * value / duration);
    else if (name === "factor") set("factor", valueOf(Number(value)));
    else if (["part", "ghost", "planned"].includes(name)) set(name, value);
  }
  frame();
  draw();
});
