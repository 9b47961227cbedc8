// Sweeps of vertex block descent over a sheet (Chen et al. 2024, "Vertex Block Descent", ACM TOG 43(4)).
//
// Block by block every vertex goes to the minimum of its own quadratic model,
//
//     x -= H^-1 g,   |H^-1 g| <= reach,
//
// g the gradient of the energy by the vertex, H its Hessian without the terms that could make it indefinite. The energy
// is that of triangles and creases (elements.hpp), of quadratic bending, and for each vertex with weight w and
// contact's stiffness c
//
//     w x_y + c/2 (gap - n.(x - p))+^2 for each of two planes + held/2 (|x - b| - slack)+^2 + friction.
//
// The first plane (p, n) is the tangent plane of the vertex's own part of the body, the second that of another part or
// the one that keeps cloth apart from cloth. b is where the network has the vertex. Friction pulls back to the place
// where the skin has taken the vertex, with mu times the force of contact, and less than SLIP_M from there with a share
// of it. Creases, which few vertices have, are added lane by lane.
//
// What is bent relaxes slowly. So a sweep that others follow takes OVER times the step (successive over-relaxation:
// Young 1954, "Iterative Methods for Solving Partial Difference Equations of Elliptic Type", Trans. AMS 76(1)) where
// cloth is farther than FREE_M from the skin, no plane keeps it from another part, and no other cloth is near.
#pragma once
#include "elements.hpp"

// The rows of a block of planes: point and normal of the own part, and of another one; stiffness and slack of the hold
// to the network's place; where the skin has taken the vertex, and friction times contact's stiffness; above 0 where
// other cloth is near.
constexpr int OWN_PLANE = 0, OTHER_PLANE = 6 * LANES, HELD_ROW = 12 * LANES, SLACK_ROW = 13 * LANES;
constexpr int STUCK = 14 * LANES, FRICTION_ROW = 17 * LANES, NEAR_ROW = 18 * LANES, PLANES = 19 * LANES;
// The rows of a block of a sheet's own numbers.
constexpr int WEIGHT = 0, BEND_DIAGONAL = LANES, CONTACT = 2 * LANES, LEASH = 3 * LANES, OWN = 4 * LANES;
constexpr double OVER = 1.5, FREE_M = 0.02;
constexpr double SLIP_M = 1e-3;  // friction is a spring up to here, and slips with the force that it has then

template <class T> struct Model {
  Points<T> gradient;        // [N]
  Symmetric<Row<T>> hessian;  // [N/m]
};

// Returns the model of weight, planes, leash and friction at the points x of a block, with the diagonal of bending.
// Without CURVATURE the Hessian has no meaning, and stiffness that a step of the whole does not know is bounded: leash
// and friction together count no more than the leash at rest plus hold times contact, and two planes no more than one.
template <bool CURVATURE, class T>
INLINE Model<T> outside(Points<T> x, const T* own, const T* planes, Points<T> network, T hold, const Fabric<T>& k) {
  const Row<T> zero = row_of(T(0));
  Row<T> contact = row_at(own + CONTACT), leash = row_at(own + LEASH);
  Points<T> normal = rows3_at(planes + OWN_PLANE + 3 * LANES), other = rows3_at(planes + OTHER_PLANE + 3 * LANES);
  Row<T> depth = k.gap - dot(x - rows3_at(planes + OWN_PLANE), normal);
  Row<T> stiffness = where<T>(depth > zero, contact, zero);
  Row<T> deep = k.gap - dot(x - rows3_at(planes + OTHER_PLANE), other);
  Row<T> stiff = where<T>(deep > zero, contact, zero);
  Points<T> way = x - network;
  Row<T> held = row_at(planes + HELD_ROW), slack = row_at(planes + SLACK_ROW);
  Row<T> length = root<T>(most<T>(dot(way, way), slack * slack));
  Row<T> pull = held * (T(1) - slack / length);  // stiffness times the way past the slack, per way
  Points<T> slip = x - rows3_at(planes + STUCK);
  slip = plus(slip, -dot(slip, normal), normal);
  Row<T> grip = row_at(planes + FRICTION_ROW) * most<T>(depth, zero);
  grip = grip / root<T>(most<T>(dot(slip, slip), row_of(T(SLIP_M * SLIP_M))));
  if (!CURVATURE) {
    Row<T> known = leash + hold * contact;
    Row<T> share = known / most<T>(grip + where<T>(length > slack, held, zero), known);
    pull = share * pull;
    grip = share * grip;
    Row<T> planes_share = contact / most<T>(stiffness + stiff * dot(other, other), contact);
    stiffness = planes_share * stiffness;
    stiff = planes_share * stiff;
  }
  Points<T> force = mix(-stiffness * depth, normal, -stiff * deep, other) + mix(pull, way, grip, slip);
  force.y = force.y + row_at(own + WEIGHT);
  if (!CURVATURE) return {force, {}};
  Row<T> still = k.least + row_at(own + BEND_DIAGONAL) + pull + grip;
  Symmetric<Row<T>> h = outer(outer({still, zero, zero, still, zero, still}, stiffness - grip, normal), stiff, other);
  Row<T> lost = where<T>(length > slack, held * slack / (length * length * length), zero);
  return {force, outer(h, lost, way)};
}

// Adds to one lane of the model a hinge that is not flat at rest. member is 4 h + c, where the lane's vertex is corner
// c of hinge h.
template <bool CURVATURE, class T>
INLINE void add_crease(Model<T>& model, const T* x, const Creases<T>& creases, int lane, int32_t member,
                       const Fabric<T>& k) {
  const int32_t* vertex = creases.corner + 4 * (member / 4);
  T cosine = creases.cosine[member / 4], sine = creases.sine[member / 4], stiffness = creases.stiffness[member / 4];
  Hinge<T> h = hinge_at(x, vertex, cosine, sine, k);
  Vector<T> by[4];
  fold_gradient(h, cosine, sine, k, by);
  Vector<T> force = by[member % 4];
  Points<T>& g = model.gradient;
  add_product(g.x, lane, stiffness, force.x);
  add_product(g.y, lane, stiffness, force.y);
  add_product(g.z, lane, stiffness, force.z);
  if (!CURVATURE) return;
  angle_gradient(h, k, by);
  Vector<T> turn = by[member % 4], b = scaled(stiffness, turn);
  Symmetric<Row<T>>& s = model.hessian;
  add_product(s.xx, lane, b.x, turn.x);
  add_product(s.xy, lane, b.x, turn.y);
  add_product(s.xz, lane, b.x, turn.z);
  add_product(s.yy, lane, b.y, turn.y);
  add_product(s.yz, lane, b.y, turn.z);
  add_product(s.zz, lane, b.z, turn.z);
}

// Returns gradient [N] and Hessian [N/m] of a block's vertices.
template <bool CURVATURE, class T>
INLINE Model<T> model_of(const T* x, int64_t block, const Sheet<T>& sheet, const T* planes, const T* network, T hold,
                         const Fabric<T>& k) {
  Points<T> own = points_in(x + 3 * LANES * block);
  Model<T> model = outside<CURVATURE>(own, sheet.own + OWN * block, planes + PLANES * block,
                                      points_in(network + 3 * LANES * block), hold, k);
  Points<T> g = model.gradient;
  Symmetric<Row<T>> h = model.hessian;
  for (int64_t row = sheet.fan_start[block]; row < sheet.fan_start[block + 1]; ++row) {
    const int32_t* other = sheet.fan_other + 2 * LANES * row;
    const T* slope = sheet.fan_slope + 5 * LANES * row;
    Points<T> first = points_at(x, other) - own, second = points_at(x, other + LANES) - own;
    Row<T> p1 = row_at(slope), t1 = row_at(slope + LANES), p2 = row_at(slope + 2 * LANES);
    Row<T> t2 = row_at(slope + 3 * LANES), area = row_at(slope + 4 * LANES);
    Columns<Row<T>> f = columns(first, second, p1, p2, t1, t2);
    Row<T> mp = -p1 - p2, mt = -t1 - t2;
    Stress<Row<T>> s = stress(f, area, k);
    Row<T> cp = mp * s.pp + mt * s.pt, ct = mp * s.pt + mt * s.tt;
    g = g + mix(cp, f.p, ct, f.t);
    if (CURVATURE) {  // Gauss-Newton of Green's strain, and the stress where it pulls
      Row<T> pp = area * (T(2) * k.warp * mp * mp + k.shear * mt * mt);
      Row<T> tt = area * (T(2) * k.weft * mt * mt + k.shear * mp * mp);
      Row<T> pt = area * (T(2) * k.cross + k.shear) * mp * mt;
      h = squares(h, pp, pt, tt, f.p, f.t, most<T>(cp * mp + ct * mt, row_of(T(0))));
    }
  }
  for (int64_t row = sheet.bend_start[block]; row < sheet.bend_start[block + 1]; ++row)
    // The rows of the bending matrix sum to zero, so it is applied to differences.
    g = plus(g, row_at(sheet.bend_value + LANES * row), points_at(x, sheet.bend_other + LANES * row) - own);
  model = {g, h};
  for (int64_t entry = sheet.crease_start[block]; entry < sheet.crease_start[block + 1]; ++entry)
    if (holds(sheet.crease_lane[entry]))
      add_crease<CURVATURE>(model, x, sheet.creases, sheet.crease_lane[entry], sheet.crease_member[entry], k);
  return model;
}

// Blocks of one colour share no element: a card moves them at once, and a processor one after the other.
#ifdef ONE_LANE
template <class T> INLINE int64_t colours_of(const Sheet<T>& sheet) { return sheet.colour_start.count - 1; }
template <class T> INLINE int64_t colour_start(const Sheet<T>& sheet, int64_t n) { return sheet.colour_start[n]; }
#else
template <class T> INLINE int64_t colours_of(const Sheet<T>&) { return 1; }
template <class T> INLINE int64_t colour_start(const Sheet<T>& sheet, int64_t n) {
  return n ? sheet.fan_start.count - 1 : 0;
}
#endif

// Returns the share of its step that each point takes in a sweep that others follow.
template <class T> INLINE Row<T> onward(Points<T> x, const T* planes) {
  const Row<T> one = row_of(T(1));
  const Points<T> normal = rows3_at(planes + OWN_PLANE + 3 * LANES), other = rows3_at(planes + OTHER_PLANE + 3 * LANES);
  const Row<T> height = dot(x - rows3_at(planes + OWN_PLANE), normal);
  const Row<T> held = dot(other, other) + row_at(planes + NEAR_ROW);
  return where<T>((height > row_of(T(FREE_M))) & (row_of(T(0.5)) > held), row_of(T(OVER)), one);
}

// Makes one sweep over x [m] (P, 3), in place, held by planes and to the places of the network [m] (P, 3). over:
// whether other sweeps follow. Behind the last point of x there is room for one number.
template <class T>
DEVICE void descend(T* x, const Sheet<T>& sheet, const T* planes, const T* network, bool over = false) {
  const Fabric<T> k(sheet.constants);
  for (int64_t colour = 0; colour < colours_of(sheet); ++colour)
    for (int64_t block : each_block(colour_start(sheet, colour), colour_start(sheet, colour + 1))) {
      Model<T> model = model_of<true>(x, block, sheet, planes, network, T(0), k);
      Points<T> step = solved(model.hessian, model.gradient);
      Row<T> share = k.reach / root<T>(most<T>(dot(step, step), row_of(k.reach * k.reach)));
      const Points<T> own = points_in(x + 3 * LANES * block);
      if (over) share = onward<T>(own, planes + PLANES * block) * share;
      put_points(x + 3 * LANES * block, plus(own, -share, step));
    }
}

// Writes the gradient [N] (P, 3) at x from which a step of the whole starts. hold is the share of contact's stiffness
// that it allows leash and friction.
template <class T>
DEVICE void gradient_at(const T* x, const Sheet<T>& sheet, const T* planes, const T* network, T hold, T* gradient) {
  const Fabric<T> k(sheet.constants);
  for (int64_t block : each_block(sheet.fan_start.count - 1))
    put_points(gradient + 3 * LANES * block, model_of<false>(x, block, sheet, planes, network, hold, k).gradient);
}
