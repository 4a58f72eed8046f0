// Rigid transforms and the pinhole camera, as in geometry.py: the centre of the top-left pixel is (0, 0).

// A row-major 4x4 matrix (16 numbers) from a translation and a quaternion x y z w.
export function matrix(tx, ty, tz, x, y, z, w) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), tx,
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), ty,
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), tz,
    0, 0, 0, 1,
  ];
}

export function multiply(a, b) {
  const c = new Array(16).fill(0);
  for (let i = 0; i < 4; i++)
    for (let j = 0; j < 4; j++)
      for (let k = 0; k < 4; k++) c[4 * i + j] += a[4 * i + k] * b[4 * k + j];
  return c;
}

export function invert(m) {
  const t = [m[3], m[7], m[11]];
  const row = (i) => [m[i], m[4 + i], m[8 + i]];
  const out = [];
  for (let i = 0; i < 3; i++) {
    const r = row(i);
    out.push(...r, -(r[0] * t[0] + r[1] * t[1] + r[2] * t[2]));
  }
  return [...out, 0, 0, 0, 1];
}

export function apply(m, [x, y, z]) {
  return [0, 4, 8].map((i) => m[i] * x + m[i + 1] * y + m[i + 2] * z + m[i + 3]);
}

// scene_from_camera from a row of the table of poses.
export function poseAt(table, row) {
  return matrix(...table.subarray(8 * row + 1, 8 * row + 8));
}

// Project a point in the camera frame to a pixel [u, v], with OpenCV's distortion; null behind the camera.
export function project(camera, [X, Y, Z]) {
  if (!(Z > 1e-6)) return null;
  const [fx, fy, cx, cy, k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0] = camera;
  const x = X / Z, y = Y / Z, r2 = x * x + y * y;
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
  const xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
  const yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y;
  return [fx * xd + cx, fy * yd + cy];
}
