//! Entry points: from a pass's domain follow a kernel's workgroups, its bounds and its signature
//! ([`Twin`](crate::twin::Twin)).

use crate::plan::{Domain, Grid};

/// Lanes of a workgroup over pixels, across and down.
const PIXELS: [u32; 2] = [8, 8];
/// Lanes of a workgroup over items.
const ITEMS: u32 = 256;
/// What the entry point of every kernel is called.
pub(crate) const ENTRY: &str = "entry_point";

/// Lanes of a workgroup, across and down.
pub(crate) fn workgroup(domain: Domain) -> [u32; 2] {
    match domain {
        Domain::Pixels => PIXELS,
        Domain::Items(_) => [ITEMS, 1],
        Domain::Tiles { width, height, .. } => [width, height],
    }
}

/// Workgroups that cover a picture, whatever the origin of a frame's tiles is.
pub(crate) fn groups(domain: Domain, picture: [u32; 2]) -> [u32; 2] {
    let [width, height] = workgroup(domain);
    let covered = match domain {
        Domain::Pixels => picture,
        Domain::Items(n) => [n, 1],
        Domain::Tiles { grid: Grid::Fixed([x, y]), .. } => {
            [picture[0] + x % width, picture[1] + y % height]
        }
        Domain::Tiles { grid: Grid::PerFrame(_), .. } => {
            [picture[0] + width - 1, picture[1] + height - 1]
        }
    };
    [covered[0].div_ceil(width), covered[1].div_ceil(height)]
}

/// Constants that kernels may use.
pub(super) fn constants(domain: Domain) -> String {
    match domain {
        Domain::Pixels | Domain::Items(_) => String::new(),
        Domain::Tiles { width, height, .. } => format!(
            "const TILE_WIDTH: u32 = {width}u;
const TILE_HEIGHT: u32 = {height}u;
const TILE_LANES: u32 = {}u;
",
            width * height
        ),
    }
}

/// The entry point that calls `kernel`.
pub(super) fn entry_point(domain: Domain, kernel: &str) -> String {
    let [width, height] = workgroup(domain);
    match domain {
        Domain::Pixels => format!(
            "@compute @workgroup_size({width}, {height})
fn {ENTRY}(@builtin(global_invocation_id) id: vec3<u32>) {{
    if id.x >= inputs.size.x || id.y >= inputs.size.y {{
        return;
    }}
    {kernel}(id.y * inputs.size.x + id.x, id.x, id.y);
    finish_counting();
}}
"
        ),
        Domain::Items(n) => format!(
            "@compute @workgroup_size({width})
fn {ENTRY}(@builtin(global_invocation_id) id: vec3<u32>) {{
    if id.x >= {n}u {{
        return;
    }}
    {kernel}(id.x);
    finish_counting();
}}
"
        ),
        Domain::Tiles { grid, .. } => format!(
            "@compute @workgroup_size({width}, {height})
fn {ENTRY}(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {{
    {}
    // Left of and above the picture these wrap, to numbers far outside.
    let x = id.x - origin_x;
    let y = id.y - origin_y;
    let inside = x < inputs.size.x && y < inputs.size.y;
    {kernel}(select(NONE, y * inputs.size.x + x, inside), x, y, lane, inside);
    finish_counting();
}}
",
            origin(grid, [width, height])
        ),
    }
}

/// The twin of [`Grid::origin`]: `origin_x` and `origin_y` of this frame.
fn origin(grid: Grid, tile: [u32; 2]) -> String {
    match grid {
        Grid::Fixed([x, y]) => {
            format!("let origin_x = {}u;\n    let origin_y = {}u;", x % tile[0], y % tile[1])
        }
        Grid::PerFrame(purpose) => format!(
            "var random = stream_new(inputs.run, 0u, inputs.frame, {}u, 0u);
    let origin_x = stream_index(&random, TILE_WIDTH);
    let origin_y = stream_index(&random, TILE_HEIGHT);",
            purpose as u32
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::Purpose;

    #[test]
    fn groups_cover_a_picture_under_every_origin() {
        let [width, height] = [16, 12];
        let tiles = |grid| Domain::Tiles { width, height, grid };
        for picture in [[1, 1], [16, 12], [17, 24], [100, 50]] {
            let mut most = [0, 0];
            for x in 0..width {
                for y in 0..height {
                    let [across, down] = groups(tiles(Grid::Fixed([x, y])), picture);
                    assert!(across * width >= picture[0] + x && down * height >= picture[1] + y);
                    most = [most[0].max(across), most[1].max(down)];
                }
            }
            assert_eq!(groups(tiles(Grid::PerFrame(Purpose::TileMask)), picture), most);
        }
        assert_eq!(groups(Domain::Pixels, [17, 8]), [3, 1]);
        assert_eq!(groups(Domain::Items(257), [17, 8]), [2, 1]);
    }
}
