//! Trees over bounding boxes by obvhs, made safe: no input panics, aborts, takes quadratic time or
//! overflows a traversal's stack.
//!
//! obvhs' clustering takes quadratic time and depth on many boxes that it cannot order (equal
//! centres), so equal boxes are grouped into one primitive beyond [`GROUP`], and a scene with more
//! than [`CONCENTRIC`] different boxes of one centre, or a tree deeper than the stacks, is built by
//! halving at the median instead: depth ≤ 32 for any input.

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::cwbvh::bvh2_to_cwbvh::bvh2_to_cwbvh;
use obvhs::cwbvh::node::CwBvhNode;
use obvhs::ploc::PlocBuilder;

use super::{BuildOptions, Layout, Quality};

/// More equal boxes than this become one primitive.
const GROUP: usize = 64;
/// More boxes with one centre than this are not given to obvhs.
const CONCENTRIC: usize = 1024;
/// Traversal stacks hold 7 entries a level of a compressed tree, 1 of a binary one.
pub(super) const STACK: usize = 128;
const MAX_DEPTH_CWBVH: usize = (STACK - 1) / 7;
const MAX_DEPTH_BVH2: usize = STACK - 1;

/// The nodes of a tree; root first.
#[derive(Clone, Debug)]
pub(super) enum Nodes {
    Cwbvh(Vec<CwBvhNode>),
    Bvh2(Vec<Bvh2Node>),
}

/// A tree whose leaves are ranges of `order`.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    pub(super) nodes: Nodes,
    pub(super) depth: usize,
    pub(super) bounds: Aabb,
}

impl Tree {
    pub(super) fn is_empty(&self) -> bool {
        match &self.nodes {
            Nodes::Cwbvh(nodes) => nodes.is_empty(),
            Nodes::Bvh2(nodes) => nodes.is_empty(),
        }
    }

    pub(super) fn node_count(&self) -> usize {
        match &self.nodes {
            Nodes::Cwbvh(nodes) => nodes.len(),
            Nodes::Bvh2(nodes) => nodes.len(),
        }
    }

    pub(super) fn bytes(&self) -> usize {
        match &self.nodes {
            Nodes::Cwbvh(nodes) => size_of_val(nodes.as_slice()),
            Nodes::Bvh2(nodes) => size_of_val(nodes.as_slice()),
        }
    }

    /// The largest |coordinate|.
    pub(super) fn reach(&self) -> f32 {
        if self.is_empty() {
            0.0
        } else {
            self.bounds.min.abs().max(self.bounds.max.abs()).max_element()
        }
    }
}

/// The boxes given to [`build_tree`], with equal ones grouped: each entry is a range of `members`.
pub(super) struct Grouped {
    pub(super) boxes: Vec<Aabb>,
    pub(super) ranges: Vec<(u32, u32)>,
    pub(super) members: Vec<u32>,
    concentric: usize,
}

/// Groups more than [`GROUP`] equal boxes into one; every other box stays alone.
pub(super) fn group(boxes: &[Aabb]) -> Grouped {
    let key = |i: u32| {
        let b = &boxes[i as usize];
        (b.center().to_array().map(f32::to_bits), b.min.to_array().map(f32::to_bits))
    };
    let mut members: Vec<u32> = (0..boxes.len() as u32).collect();
    members.sort_by_cached_key(|&i| (key(i), i));
    let mut grouped = Grouped { boxes: vec![], ranges: vec![], members: vec![], concentric: 0 };
    let mut singles: Vec<u32> = Vec::with_capacity(boxes.len());
    for same_center in members.chunk_by(|&a, &b| key(a).0 == key(b).0) {
        let mut distinct = 0;
        for equal in same_center.chunk_by(|&a, &b| key(a) == key(b)) {
            if equal.len() > GROUP {
                grouped.ranges.push((grouped.members.len() as u32, equal.len() as u32));
                grouped.members.extend_from_slice(equal);
                grouped.boxes.push(boxes[equal[0] as usize]);
                distinct += 1;
            } else {
                singles.extend_from_slice(equal);
                distinct += equal.len();
            }
        }
        grouped.concentric = grouped.concentric.max(distinct);
    }
    // In the input's order, so that ties inside the builder do not depend on the sort.
    singles.sort_unstable();
    for single in singles {
        grouped.ranges.push((grouped.members.len() as u32, 1));
        grouped.members.push(single);
        grouped.boxes.push(boxes[single as usize]);
    }
    grouped
}

/// Every box for itself; with many equal ones, obvhs' clustering is not used.
pub(super) fn alone(boxes: Vec<Aabb>) -> Grouped {
    let grouped = group(&boxes);
    let ungrouped = grouped.boxes.len() == boxes.len();
    Grouped {
        ranges: (0..boxes.len() as u32).map(|i| (i, 1)).collect(),
        members: (0..boxes.len() as u32).collect(),
        boxes,
        concentric: if ungrouped { grouped.concentric } else { usize::MAX },
    }
}

/// A tree over `grouped.boxes`, and the order of the boxes in its leaves.
pub(super) fn build_tree(grouped: &Grouped, options: &BuildOptions) -> (Tree, Vec<u32>) {
    let boxes = &grouped.boxes;
    let empty = Aabb::new(Vec3A::ZERO, Vec3A::ZERO);
    if boxes.is_empty() {
        let nodes = match options.layout {
            Layout::Cwbvh => Nodes::Cwbvh(vec![]),
            Layout::Bvh2 => Nodes::Bvh2(vec![]),
        };
        return (Tree { nodes, depth: 0, bounds: empty }, vec![]);
    }
    let params = options.quality.params();
    let clustered = (grouped.concentric <= CONCENTRIC)
        .then(|| cluster(boxes, &params))
        .filter(|bvh| depth(&bvh.nodes) <= MAX_DEPTH_BVH2);
    if let Some(bvh) = clustered
        && let Some(done) = finish(bvh, boxes, &params, options.layout)
    {
        return done;
    }
    let halved = halve(boxes);
    finish(halved, boxes, &BvhBuildParams::fastest_build(), options.layout)
        .expect("a tree of depth 32 fits the stack")
}

fn cluster(boxes: &[Aabb], params: &BvhBuildParams) -> Bvh2 {
    let indices = (0..boxes.len() as u32).collect();
    let mut bvh = PlocBuilder::with_capacity(boxes.len()).build(
        params.ploc_search_distance,
        boxes,
        indices,
        params.sort_precision,
        params.search_depth_threshold,
    );
    // Too deep a tree would overflow the thread's stack in the steps that recurse.
    if depth(&bvh.nodes) <= MAX_DEPTH_BVH2 {
        ReinsertionOptimizer::default().run(&mut bvh, params.reinsertion_batch_ratio, None);
    }
    bvh
}

fn finish(
    mut bvh: Bvh2,
    boxes: &[Aabb],
    params: &BvhBuildParams,
    layout: Layout,
) -> Option<(Tree, Vec<u32>)> {
    let bounds = *bvh.nodes[0].aabb();
    match layout {
        Layout::Cwbvh => {
            let wide = bvh2_to_cwbvh(&bvh, params.max_prims_per_leaf.clamp(1, 3), true, false);
            let mut nodes = wide.nodes;
            let depth = quantize(&mut nodes, &wide.primitive_indices, boxes);
            (depth <= MAX_DEPTH_CWBVH).then_some((
                Tree { nodes: Nodes::Cwbvh(nodes), depth, bounds },
                wide.primitive_indices,
            ))
        }
        Layout::Bvh2 => {
            collapse(&mut bvh, params.max_prims_per_leaf, params.collapse_traversal_cost);
            let ratio = params.reinsertion_batch_ratio
                * params.post_collapse_reinsertion_batch_ratio_multiplier;
            ReinsertionOptimizer::default().run(&mut bvh, ratio, None);
            let depth = depth(&bvh.nodes);
            (depth <= MAX_DEPTH_BVH2).then_some((
                Tree { nodes: Nodes::Bvh2(bvh.nodes), depth, bounds },
                bvh.primitive_indices,
            ))
        }
    }
}

/// Levels of a binary tree, without recursion.
fn depth(nodes: &[Bvh2Node]) -> usize {
    let mut stack = vec![(0_u32, 1_usize)];
    let mut deepest = 0;
    while let Some((index, level)) = stack.pop() {
        deepest = deepest.max(level);
        let node = &nodes[index as usize];
        if !node.is_leaf() {
            stack.push((node.first_index, level + 1));
            stack.push((node.first_index + 1, level + 1));
        }
    }
    deepest
}

/// One primitive a leaf, halved at the median centre of the longest axis (by number among equals).
fn halve(boxes: &[Aabb]) -> Bvh2 {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = vec![Bvh2Node::new(boxes[0], 0, 0)];
    let mut stack = vec![(0_usize, 0_usize, boxes.len())];
    while let Some((index, start, end)) = stack.pop() {
        let range = &mut order[start..end];
        let bounds =
            range.iter().fold(boxes[range[0] as usize], |b, &i| b.union(&boxes[i as usize]));
        if range.len() == 1 {
            nodes[index] = Bvh2Node::new(bounds, 1, start as u32);
            continue;
        }
        let center = |i: u32| boxes[i as usize].center();
        let (low, high) = range.iter().fold((Vec3A::MAX, Vec3A::MIN), |(low, high), &i| {
            (low.min(center(i)), high.max(center(i)))
        });
        let axis = (high - low).max_position();
        let half = range.len() / 2;
        range.select_nth_unstable_by(half, |&a, &b| {
            center(a)[axis].total_cmp(&center(b)[axis]).then(a.cmp(&b))
        });
        let first = nodes.len();
        nodes.extend([Bvh2Node::new(bounds, 0, 0); 2]);
        nodes[index] = Bvh2Node::new(bounds, 0, first as u32);
        stack.push((first, start, start + half));
        stack.push((first + 1, start + half, end));
    }
    Bvh2 {
        max_depth: depth(&nodes),
        nodes,
        primitive_indices: order,
        children_are_ordered_after_parents: true,
        ..Bvh2::default()
    }
}

/// Replaces the compressed planes by such that bound their children exactly, and returns the number
/// of levels.
///
/// obvhs rounds `(min − p) / e` before it takes the floor, and clamps where the rounded `log2` was
/// too low: planes may lie inside of what they bound by some 10⁻⁷ of the node. Here p, e and the
/// differences are compared in f64, where they are exact or nearly so.
fn quantize(nodes: &mut [CwBvhNode], order: &[u32], boxes: &[Aabb]) -> usize {
    let none = Aabb::INVALID;
    let mut bounds = vec![none; nodes.len()];
    let mut levels = vec![1_usize; nodes.len()];
    // Children come after their parents.
    for index in (0..nodes.len()).rev() {
        let node = &mut nodes[index];
        let mut children = [none; 8];
        for (slot, child) in children.iter_mut().enumerate() {
            if node.is_child_empty(slot) {
                continue;
            }
            if node.is_leaf(slot) {
                let (start, count) = node.child_primitives(slot);
                for &primitive in &order[start as usize..(start + count) as usize] {
                    *child = child.union(&boxes[primitive as usize]);
                }
            } else {
                let at = node.child_node_index(slot) as usize;
                *child = bounds[at];
                levels[index] = levels[index].max(levels[at] + 1);
            }
        }
        let total = children.iter().fold(none, |a, b| a.union(b));
        bounds[index] = total;
        node.p = total.min.into();
        for axis in 0..3 {
            let corner = f64::from(total.min[axis]);
            let extent = f64::from(total.max[axis]) - corner;
            // The least exponent with 255 e ≥ extent; 0 stands for e = 0.
            let mut exponent = 0_u8;
            if extent > 0.0 {
                exponent = (((extent / 255.0) as f32).to_bits() >> 23).max(1) as u8;
                while 255.0 * spacing(exponent) < extent {
                    exponent += 1;
                }
            }
            node.e[axis] = exponent;
            let e = spacing(exponent);
            let (mut low, mut high) = ([0_u8; 8], [0_u8; 8]);
            for (slot, child) in children.iter().enumerate() {
                if node.child_meta[slot] == 0 || e == 0.0 {
                    continue;
                }
                let (min, max) = (f64::from(child.min[axis]), f64::from(child.max[axis]));
                low[slot] = ((min - corner) / e).floor() as u8;
                high[slot] = ((max - corner) / e).ceil() as u8;
            }
            let (node_low, node_high) = match axis {
                0 => (&mut node.child_min_x, &mut node.child_max_x),
                1 => (&mut node.child_min_y, &mut node.child_max_y),
                _ => (&mut node.child_min_z, &mut node.child_max_z),
            };
            (*node_low, *node_high) = (low, high);
        }
    }
    levels.first().copied().unwrap_or(0)
}

fn spacing(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}

impl Quality {
    fn params(self) -> BvhBuildParams {
        match self {
            Self::Fast => BvhBuildParams::fast_build(),
            Self::Medium => BvhBuildParams::medium_build(),
            Self::High => BvhBuildParams { pre_split: false, ..BvhBuildParams::very_slow_build() },
        }
    }
}
