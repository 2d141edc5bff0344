//! Ordered traversal of both layouts, for any kernel of node and triangle tests.
//!
//! The stack holds children with the distance at which the ray enters them, nearest on top; one
//! that lies behind the closest hit by the time it is popped is skipped. Leaves wait on the stack
//! as nodes do.

use glam::Vec3;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::cwbvh::node::CwBvhNode;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;

use super::build::{Nodes, Tree};
use super::node::{self, BoxRay, Children};
use super::triangle::{self, Edges, Slot, TriangleRay};

/// The tests that exist in a plain and a vector form. Both forms of the triangle test give the same
/// bits; both forms of the node test are conservative, so hits never depend on the kernel.
pub(super) trait Kernel: Copy {
    fn children(self, node: &CwBvhNode, ray: &BoxRay, t_max: f32) -> Children;
    fn edges(self, slot: &Slot, ray: &TriangleRay) -> Option<Edges>;
}

/// Plain Rust; what the compiler makes of it for the target's base instruction set.
#[derive(Clone, Copy, Debug)]
pub(super) struct Portable;

impl Kernel for Portable {
    #[inline(always)]
    fn children(self, node: &CwBvhNode, ray: &BoxRay, t_max: f32) -> Children {
        node::children_portable(node, ray, t_max)
    }

    #[inline(always)]
    fn edges(self, slot: &Slot, ray: &TriangleRay) -> Option<Edges> {
        triangle::edges_portable(slot, ray)
    }
}

#[cfg(target_arch = "x86_64")]
impl Kernel for V3 {
    #[inline(always)]
    fn children(self, node: &CwBvhNode, ray: &BoxRay, t_max: f32) -> Children {
        node::children_avx2(self, node, ray, t_max)
    }

    #[inline(always)]
    fn edges(self, slot: &Slot, ray: &TriangleRay) -> Option<Edges> {
        triangle::edges_avx2(self, slot, ray)
    }
}

/// What is done at the leaves.
pub(super) trait Visitor<K> {
    /// Whether any hit will do, so that order does not matter.
    const ANY: bool;
    /// Where the search ends now.
    fn limit(&self) -> f32;
    /// Tests primitives `first .. first + count` in leaf order; true ends the traversal.
    fn leaf(&mut self, kernel: K, first: u32, count: u32) -> bool;
}

#[derive(Clone, Copy, Default)]
struct Entry {
    /// A node; or with [`LEAF`], a count in bits 29 and 30 and the first primitive below.
    child: u32,
    near: f32,
}

const LEAF: u32 = 1 << 31;
/// Primitives beyond this cannot be named by an [`Entry`].
pub(super) const MAX_SLOTS: usize = 1 << 29;

/// Entries that almost every ray gets by with: clearing a stack for the deepest tree costs as much
/// as a node.
const SHALLOW: usize = 32;

/// Traverses `tree`, whose depth must suit `STACK` (see `build`). True if a leaf ended it.
#[inline(always)]
pub(super) fn traverse<const STACK: usize, K: Kernel, V: Visitor<K> + Visitor<Portable>>(
    kernel: K,
    tree: &Tree,
    ray: &BoxRay,
    visitor: &mut V,
) -> bool {
    match &tree.nodes {
        Nodes::Cwbvh(nodes) => match cwbvh::<SHALLOW, K, V>(kernel, nodes, ray, visitor) {
            Some(ended) => ended,
            None => deep::<STACK, V>(nodes, ray, visitor),
        },
        Nodes::Bvh2(nodes) => bvh2::<STACK, K, V>(kernel, nodes, ray, visitor),
    }
}

/// The same search from the start (what was found so far still bounds it), with a stack that no
/// tree overflows.
#[cold]
#[inline(never)]
fn deep<const STACK: usize, V: Visitor<Portable>>(
    nodes: &[CwBvhNode],
    ray: &BoxRay,
    visitor: &mut V,
) -> bool {
    cwbvh::<STACK, Portable, V>(Portable, nodes, ray, visitor)
        .expect("the build bounds a tree's depth by its stack")
}

/// `None`: the stack is too small.
#[inline(always)]
fn cwbvh<const STACK: usize, K: Kernel, V: Visitor<K>>(
    kernel: K,
    nodes: &[CwBvhNode],
    ray: &BoxRay,
    visitor: &mut V,
) -> Option<bool> {
    if nodes.is_empty() {
        return Some(false);
    }
    let mut stack = [Entry::default(); STACK];
    let mut top = 0;
    let mut child = 0;
    loop {
        if child & LEAF != 0 {
            if visitor.leaf(kernel, child & (MAX_SLOTS as u32 - 1), (child >> 29) & 3) {
                return Some(true);
            }
        } else {
            let node = &nodes[child as usize];
            let (mut mask, near) = kernel.children(node, ray, visitor.limit());
            let base = top;
            if top + mask.count_ones() as usize > STACK {
                return None;
            }
            while mask != 0 {
                let slot = mask.trailing_zeros() as usize & 7;
                mask &= mask - 1;
                let below = u32::from(node.imask) & ((1 << slot) - 1);
                let meta = u32::from(node.child_meta[slot]);
                let inner = node.child_base_idx + below.count_ones();
                let leaf = LEAF
                    | ((meta >> 5).count_ones() << 29)
                    | (node.primitive_base_idx + (meta & 31));
                let is_inner = node.imask >> slot & 1 == 1;
                let entry = Entry { child: if is_inner { inner } else { leaf }, near: near[slot] };
                let mut at = top;
                if !V::ANY {
                    while at > base && stack[at - 1].near < entry.near {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                }
                stack[at] = entry;
                top += 1;
            }
        }
        loop {
            if top == 0 {
                return Some(false);
            }
            top -= 1;
            if stack[top].near <= visitor.limit() {
                child = stack[top].child;
                break;
            }
        }
    }
}

#[inline(always)]
fn bvh2<const STACK: usize, K: Kernel, V: Visitor<K>>(
    kernel: K,
    nodes: &[Bvh2Node],
    ray: &BoxRay,
    visitor: &mut V,
) -> bool {
    if nodes.is_empty() || ray.bvh2(&nodes[0], visitor.limit()).is_none() {
        return false;
    }
    let mut stack = [Entry::default(); STACK];
    let mut top = 0;
    let mut at = 0_u32;
    loop {
        let node = &nodes[at as usize];
        let mut next = None;
        if node.is_leaf() {
            if visitor.leaf(kernel, node.first_index, node.prim_count) {
                return true;
            }
        } else {
            let (left, right) = (node.first_index, node.first_index + 1);
            let limit = visitor.limit();
            let a = ray.bvh2(&nodes[left as usize], limit);
            let b = ray.bvh2(&nodes[right as usize], limit);
            next = match [a, b] {
                [Some(a), Some(b)] => {
                    let (first, later) =
                        if a <= b { (left, (right, b)) } else { (right, (left, a)) };
                    stack[top] = Entry { child: later.0, near: later.1 };
                    top += 1;
                    Some(first)
                }
                [Some(_), None] => Some(left),
                [None, Some(_)] => Some(right),
                [None, None] => None,
            };
        }
        at = loop {
            if let Some(next) = next {
                break next;
            }
            if top == 0 {
                return false;
            }
            top -= 1;
            if stack[top].near <= visitor.limit() {
                break stack[top].child;
            }
        };
    }
}

/// A ray as it enters every traversal: scaled, checked, in f64 where it matters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scaled {
    pub(super) origin: Vec3,
    /// The largest component is within [2⁻¹⁶, 2¹⁶].
    pub(super) direction: Vec3,
    pub(super) t_max: f64,
    /// The caller's t over the one here; a power of two.
    pub(super) unit: f64,
}

/// `None`: the ray is not one (NaN, infinite, no direction, empty range, origin beyond ±10¹⁸), and
/// misses everything.
#[inline(always)]
pub(super) fn scale(ray: &super::Ray) -> Option<Scaled> {
    let m = ray.direction.abs().max_element();
    let valid = ray.direction.is_finite()
        && ray.origin.abs().cmple(Vec3::splat(super::MAX_COORDINATE)).all()
        && m > 0.0
        && ray.t_max > 0.0;
    if !valid {
        return None;
    }
    let t_max = f64::from(ray.t_max);
    const LARGE: f32 = 65536.0;
    if (1.0 / LARGE..=LARGE).contains(&m) {
        return Some(Scaled { origin: ray.origin, direction: ray.direction, t_max, unit: 1.0 });
    }
    // f64 holds every f32, subnormal ones too, as a normal number: its exponent is m's.
    let exponent = (f64::from(m).to_bits() >> 52) & 0x7ff;
    let unit = f64::from_bits((2046 - exponent) << 52);
    let direction = (ray.direction.as_dvec3() * unit).as_vec3();
    Some(Scaled { origin: ray.origin, direction, t_max: t_max / unit, unit })
}
