//! Ray-box tests of the two node layouts, conservative without an epsilon.
//!
//! | symbol | meaning |
//! |---|---|
//! | p, q, e | a compressed node's corner, its children's planes in [0, 255], the planes' spacing (a power of two, per axis) |
//! | o, d | ray; m: the largest |d_i|, within [2⁻¹⁶, 2¹⁶] (longer and shorter rays are scaled by a power of two before) |
//! | a, b | (p − o) / d and e / d, so that a plane is at t = a + q b |
//! | u | 2⁻²⁴ |
//!
//! *Rounding.* a carries 3 roundings, b one, the sum and its slack 3, the comparison with a rounded
//! t one, the rounding of an instance's ray two: each is at most u (|a| + 255 |b|), as any t inside
//! the node is. So near planes move by −16u (|a| + 255 |b|) and far planes by the same upwards,
//! which is one operation a node, not one a child. The quantised planes themselves are outside of
//! what they bound, exactly (see `build`).
//!
//! *Axis-parallel rays.* Where |`d_i`| < 2⁻³⁰ m the axis only asks whether `o_i` lies between the
//! planes, and 1 / `d_i` may be infinite. With R ≥ |`o_j`| + |any coordinate|, nothing is hit
//! beyond t = R / m and the ray drifts less than 2⁻³⁰ R along i until then. So 1 / `d_i` is
//! replaced by 2³⁰ / m and the slack raised by 2 R / m: a box that is missed by more than 2⁻²⁹ R
//! still is, one that contains `o_i` never. No infinity arises, so no NaN.

use glam::{Vec3, Vec3A};
use obvhs::bvh2::node::Bvh2Node;
use obvhs::cwbvh::node::CwBvhNode;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;

/// A ray in the form of the tests, computed once.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoxRay {
    origin: Vec3A,
    inverse: Vec3A,
    slack: Vec3A,
    /// 1 on axes with a negative direction.
    pub(super) negative: [usize; 3],
}

/// 16u, see the module.
const ROUNDING: f32 = 8.0 * f32::EPSILON;

impl BoxRay {
    /// Unless `rounded`, `direction`'s largest component must be within [2⁻¹⁶, 2¹⁶]; `reach` ≥ |any
    /// coordinate of the tree|. `rounded`: origin and direction were rounded to f32 from a
    /// transformed ray.
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3, reach: f32, rounded: bool) -> Self {
        if rounded && !Self::in_range(origin, direction) {
            return Self::everything();
        }
        let magnitude = direction.abs();
        let m = magnitude.max_element();
        let negative = [direction.x < 0.0, direction.y < 0.0, direction.z < 0.0].map(usize::from);
        const PARALLEL: f32 = 1.0 / (1 << 30) as f32;
        let limit = m * PARALLEL;
        let (mut inverse, mut slack) = (Vec3::ONE / direction, Vec3::ZERO);
        if magnitude.min_element() < limit {
            let range = 2.0 * (origin.abs().max_element() + reach) / m;
            for axis in 0..3 {
                if magnitude[axis] < limit {
                    inverse[axis] = if negative[axis] == 1 { -1.0 } else { 1.0 } / limit;
                    slack[axis] = range;
                }
            }
        }
        if rounded {
            slack += origin.abs() * inverse.abs() * f32::EPSILON;
        }
        Self { origin: origin.into(), inverse: inverse.into(), slack: slack.into(), negative }
    }

    /// An instance's transform may bring a ray anywhere.
    #[inline(always)]
    fn in_range(origin: Vec3, direction: Vec3) -> bool {
        let m = direction.abs().max_element();
        const LIMIT: f32 = (1_u64 << 40) as f32;
        // NaN compares false.
        (1.0 / LIMIT..=LIMIT).contains(&m) && origin.abs().max_element() <= super::MAX_COORDINATE
    }

    /// Hits every box: slow and right.
    #[cold]
    fn everything() -> Self {
        let slack = Vec3A::splat(f32::INFINITY);
        Self { origin: Vec3A::ZERO, inverse: Vec3A::ZERO, slack, negative: [0; 3] }
    }

    /// b, a minus slack, a plus slack.
    #[inline(always)]
    fn planes(&self, node: &CwBvhNode) -> (Vec3A, Vec3A, Vec3A) {
        let b = node.compute_extent() * self.inverse;
        let a = (Vec3A::from(node.p) - self.origin) * self.inverse;
        let slack = (a.abs() + b.abs() * 255.0) * ROUNDING + self.slack;
        (b, a - slack, a + slack)
    }

    /// The least t of the box at which it may be hit, if any is ≤ `t_max`.
    #[inline(always)]
    pub(super) fn bvh2(&self, node: &Bvh2Node, t_max: f32) -> Option<f32> {
        let bounds = node.aabb();
        let t0 = (bounds.min - self.origin) * self.inverse;
        let t1 = (bounds.max - self.origin) * self.inverse;
        let (near, far) = (t0.min(t1), t0.max(t1));
        let near = (near - near.abs() * ROUNDING - self.slack).max_element().max(0.0);
        let far = (far + far.abs() * ROUNDING + self.slack).min_element().min(t_max);
        (near <= far).then_some(near)
    }
}

/// The children that a ray may hit before `t_max`, as bits, and where it enters each.
pub(super) type Children = (u32, [f32; 8]);

/// All eight children, in plain loops.
#[inline(always)]
pub(super) fn children_portable(node: &CwBvhNode, ray: &BoxRay, t_max: f32) -> Children {
    let (b, low, high) = ray.planes(node);
    let bytes: &[[u8; 8]; 10] = bytemuck::cast_ref(node);
    let (mut near, mut far) = ([0.0_f32; 8], [t_max; 8]);
    for axis in 0..3 {
        let (q0, q1) = (bytes[4 + 2 * axis], bytes[5 + 2 * axis]);
        let (qn, qf) = if ray.negative[axis] == 1 { (q1, q0) } else { (q0, q1) };
        let (b, low, high) = (b[axis], low[axis], high[axis]);
        for child in 0..8 {
            let enter = f32::from(qn[child]) * b + low;
            let leave = f32::from(qf[child]) * b + high;
            near[child] = if enter > near[child] { enter } else { near[child] };
            far[child] = if leave < far[child] { leave } else { far[child] };
        }
    }
    let mut mask = 0;
    for child in 0..8 {
        mask |= u32::from(near[child] <= far[child] && node.child_meta[child] != 0) << child;
    }
    (mask, near)
}

/// `q b + at` for eight quantised planes.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn plane(simd: V3, q: [u8; 8], b: f32, at: f32) -> std::arch::x86_64::__m256 {
    let q = simd.sse2._mm_set_epi64x(0, i64::from_le_bytes(q));
    let q = simd.avx._mm256_cvtepi32_ps(simd.avx2._mm256_cvtepu8_epi32(q));
    simd.fma._mm256_fmadd_ps(q, simd.avx._mm256_set1_ps(b), simd.avx._mm256_set1_ps(at))
}

/// All eight children at once. No closures: they would be compiled without the vector instructions.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(super) fn children_avx2(simd: V3, node: &CwBvhNode, ray: &BoxRay, t_max: f32) -> Children {
    use std::arch::x86_64::_CMP_LE_OQ;
    let (sse2, avx) = (simd.sse2, simd.avx);
    let (b, low, high) = ray.planes(node);
    let bytes: &[[u8; 8]; 10] = bytemuck::cast_ref(node);
    let [sx, sy, sz] = ray.negative;
    let (sx, sy, sz) = (sx & 1, sy & 1, sz & 1);
    let near = avx._mm256_max_ps(
        avx._mm256_max_ps(
            plane(simd, bytes[4 + sx], b.x, low.x),
            plane(simd, bytes[6 + sy], b.y, low.y),
        ),
        avx._mm256_max_ps(plane(simd, bytes[8 + sz], b.z, low.z), avx._mm256_set1_ps(0.0)),
    );
    let far = avx._mm256_min_ps(
        avx._mm256_min_ps(
            plane(simd, bytes[5 - sx], b.x, high.x),
            plane(simd, bytes[7 - sy], b.y, high.y),
        ),
        avx._mm256_min_ps(plane(simd, bytes[9 - sz], b.z, high.z), avx._mm256_set1_ps(t_max)),
    );
    let hit = avx._mm256_movemask_ps(avx._mm256_cmp_ps::<_CMP_LE_OQ>(near, far)) as u32;
    let meta = sse2._mm_set_epi64x(0, i64::from_le_bytes(bytes[3]));
    let empty = sse2._mm_movemask_epi8(sse2._mm_cmpeq_epi8(meta, sse2._mm_setzero_si128())) as u32;
    (hit & !empty, bytemuck::cast(near))
}
