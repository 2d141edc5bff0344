// Twin of `reuse::boiling`: drops reservoirs that are far brighter than their tile's mean. A
// workgroup is a tile.

override BOILING_LIMIT: f32 = 1.0;

var<workgroup> tile_sum: array<f32, TILE_LANES>;
var<workgroup> tile_count: array<u32, TILE_LANES>;

fn boiling(pixel: u32, x: u32, y: u32, lane: u32, inside: bool) {
    for (var chain = 0u; chain < chains(); chain++) {
        var record = record_empty(0u);
        if inside {
            record = read_record(buffer_now(B_RESERVOIRS), chain_place(pixel, chain));
        }
        // p̂ W: what a reservoir would show of luminance without visibility.
        let shown = select(0.0, record.target_luminance * record.weight, record.weight > 0.0);
        let mean = tile_mean(lane, shown);
        if inside && shown > BOILING_LIMIT * mean {
            let at = chain_place(pixel, chain);
            write_record(buffer_now(B_RESERVOIRS), at, record_empty(record.packed));
        }
    }
}

// The mean of what is positive among the numbers of a tile's lanes. All lanes must call it.
fn tile_mean(lane: u32, number: f32) -> f32 {
    tile_sum[lane] = number;
    tile_count[lane] = select(0u, 1u, number > 0.0);
    workgroupBarrier();
    // The upper lanes are added to the lower ones, which are no fewer, until one is left.
    for (var left = TILE_LANES; left > 1u; left = (left + 1u) / 2u) {
        let lower = (left + 1u) / 2u;
        if lane + lower < left {
            tile_sum[lane] += tile_sum[lane + lower];
            tile_count[lane] += tile_count[lane + lower];
        }
        workgroupBarrier();
    }
    let mean = tile_sum[0] / f32(max(tile_count[0], 1u));
    workgroupBarrier();
    return mean;
}
