// The depth that a click would get, and whether it is unreliable: the surfaces around the cursor, split
// where the depth jumps by more than the sensor's noise, as lift.py does it.

const RADIUS_PX = 14;

// {text, warn} for the cursor; tile is the depth around it in units, 0 = none.
export function describeDepth(tile, scene, u, v) {
  if (!tile) return { text: "depth …", warn: false };
  const here = at(tile, Math.round(u), Math.round(v)) * scene.metres_per_unit;
  const found = surfaces(tile, scene, u, v);
  const metres = here > 0 ? `${here.toFixed(3)} m` : "no depth";
  if (!found.length) return { text: `${metres} · hole: no depth around here, choose another frame`, warn: true };
  if (here === 0) return { text: `${metres} here · nearest ${found[0].toFixed(3)} m beside it`, warn: true };
  if (found.length > 1) {
    const step = 1000 * (found[1] - found[0]);
    return { text: `${metres} · edge: depth jumps ${step.toFixed(0)} mm here`, warn: true };
  }
  return { text: metres, warn: false };
}

const at = ({ data, left, top, side }, x, y) => data[(y - top) * side + x - left];

// Nearest depth (m) of every surface with at least four pixels around a position, nearest first.
export function surfaces(tile, scene, u, v) {
  const depths = [];
  for (let y = Math.max(0, Math.ceil(v - RADIUS_PX)); y <= Math.min(scene.height - 1, v + RADIUS_PX); y++)
    for (let x = Math.max(0, Math.ceil(u - RADIUS_PX)); x <= Math.min(scene.width - 1, u + RADIUS_PX); x++) {
      const d = at(tile, x, y);
      if (d && Math.hypot(x - u, y - v) <= RADIUS_PX) depths.push(d * scene.metres_per_unit);
    }
  depths.sort((a, b) => a - b);
  const pieces = [];
  let start = 0;
  for (let i = 1; i <= depths.length; i++) {
    const sigma = 1.5e-3 * (depths[i] / 0.7) ** 2;
    if (i === depths.length || depths[i] - depths[i - 1] > Math.max(0.008, 4 * sigma)) {
      if (i - start >= 4) pieces.push(depths[start]);
      start = i;
    }
  }
  return pieces;
}
