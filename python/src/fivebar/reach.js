"use strict";
// Reach and singular loci of a machine behind a picture of it. Points are [x, y] in m; `outline` is what `fivebar.borders.outline` gives.

/** Working mode of a posture from the angles of links 1 to 4, rad: the loci that are drawn are those of this mode. */
function workingMode([t1, t2, t3, t4]) {
  const left = Math.sin(t2 - t1) < 0 ? "minus" : "plus", right = Math.sin(t3 - t4) < 0 ? "Minus" : "Plus";
  return left + right;
}

/** Lets `pen` paint only where both legs reach; `at` leads from m to pixels, which are `scale` to the metre. */
function clipToReach(pen, outline, at, scale, width, height) {
  for (const { centre, outer, inner } of outline.rings) {
    const [x, y] = at(centre), ring = new Path2D();
    ring.arc(x, y, outer * scale, 0, 2 * Math.PI);
    pen.clip(ring);
    const outside = new Path2D();
    outside.rect(0, 0, width, height);
    outside.moveTo(x + inner * scale, y);
    outside.arc(x, y, inner * scale, 0, 2 * Math.PI);
    pen.clip(outside, "evenodd");
  }
}

/** Curves in m as lines of one path, so that those that coincide are not darker. */
function strokeCurves(pen, curves, at) {
  pen.beginPath();
  for (const curve of curves) curve.forEach((point, i) => (i ? pen.lineTo(...at(point)) : pen.moveTo(...at(point))));
  pen.stroke();
}

/** Circles of stretched and folded legs, each as far as the other leg reaches. */
function strokeRims(pen, outline, at, scale) {
  outline.rings.forEach(({ centre, outer, inner }, i) => {
    const other = outline.rings[1 - i], clip = new Path2D();
    clip.arc(...at(other.centre), other.outer * scale + 1, 0, 2 * Math.PI);
    pen.save();
    pen.clip(clip);
    for (const radius of [outer, inner]) if (radius > 0) { pen.beginPath(); pen.arc(...at(centre), radius * scale, 0, 2 * Math.PI); pen.stroke(); }
    pen.restore();
  });
}

/** The reach, its rims and the direct loci of a working mode, lightly. `colours` has reach, inverse and direct. */
function drawReach(pen, outline, mode, at, scale, width, height, colours) {
  pen.save();
  clipToReach(pen, outline, at, scale, width, height);
  pen.fillStyle = colours.reach;
  pen.fillRect(0, 0, width, height);
  pen.restore();
  pen.save();
  pen.lineWidth = 1;
  pen.globalAlpha = 0.45;
  pen.strokeStyle = colours.inverse;
  pen.setLineDash([2, 4]);
  strokeRims(pen, outline, at, scale);
  pen.setLineDash([]);
  pen.strokeStyle = colours.direct;
  strokeCurves(pen, outline.loci[mode] ?? [], at);
  pen.restore();
}
