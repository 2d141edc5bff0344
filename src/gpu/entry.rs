//! Entry points: from what a kernel runs over follow its workgroups, its bounds and its signature
//! ([`Twin`](crate::twin::Twin)).

use crate::math::rng::Purpose;

/// Lanes of a workgroup over pixels, across and down.
const PIXELS: [u32; 2] = [8, 8];
/// Lanes of a workgroup over items.
const ITEMS: u32 = 256;
/// What the entry point of every kernel is called.
pub(crate) const ENTRY: &str = "entry_point";

/// What the lanes of a kernel own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lanes {
    /// A pixel each.
    Pixels,
    /// One of n items each.
    Items(u32),
    /// A pixel each; a workgroup is a tile of the picture.
    Tiles {
        /// Pixels across and down.
        size: [u32; 2],
        origin: Origin,
    },
}

/// How far left of and above the picture a grid of tiles begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Origin {
    Fixed([u32; 2]),
    /// Drawn anew in each frame, less than a tile's size: `index(width)` and `index(height)` of the
    /// frame's stream of this purpose for cell 0.
    PerFrame(Purpose),
}

impl Lanes {
    /// Lanes of a workgroup, across and down.
    pub(crate) fn workgroup(self) -> [u32; 2] {
        match self {
            Self::Pixels => PIXELS,
            Self::Items(_) => [ITEMS, 1],
            Self::Tiles { size, .. } => size,
        }
    }

    /// Workgroups that cover a picture, whatever a frame's origin is.
    pub(crate) fn groups(self, picture: [u32; 2]) -> [u32; 2] {
        let [width, height] = self.workgroup();
        let covered = match self {
            Self::Pixels => picture,
            Self::Items(n) => [n, 1],
            Self::Tiles { origin: Origin::Fixed([x, y]), .. } => [picture[0] + x, picture[1] + y],
            Self::Tiles { origin: Origin::PerFrame(_), .. } => {
                [picture[0] + width - 1, picture[1] + height - 1]
            }
        };
        [covered[0].div_ceil(width), covered[1].div_ceil(height)]
    }

    /// Constants that kernels may use.
    pub(super) fn constants(self) -> String {
        match self {
            Self::Pixels | Self::Items(_) => String::new(),
            Self::Tiles { size: [width, height], .. } => format!(
                "const TILE_WIDTH: u32 = {width}u;\nconst TILE_HEIGHT: u32 = {height}u;\nconst TILE_LANES: u32 = {}u;\n",
                width * height
            ),
        }
    }

    /// The entry point that calls `kernel`.
    pub(super) fn entry_point(self, kernel: &str) -> String {
        let [width, height] = self.workgroup();
        match self {
            Self::Pixels => format!(
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
            Self::Items(n) => format!(
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
            Self::Tiles { origin, .. } => {
                let origin = match origin {
                    Origin::Fixed([x, y]) => {
                        format!("let origin_x = {x}u;\n    let origin_y = {y}u;")
                    }
                    Origin::PerFrame(purpose) => format!(
                        "var random = stream_new(inputs.run, 0u, inputs.frame, {}u, 0u);
    let origin_x = stream_index(&random, TILE_WIDTH);
    let origin_y = stream_index(&random, TILE_HEIGHT);",
                        purpose as u32
                    ),
                };
                format!(
                    "@compute @workgroup_size({width}, {height})
fn {ENTRY}(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {{
    {origin}
    // Left of and above the picture these wrap, to numbers far outside.
    let x = id.x - origin_x;
    let y = id.y - origin_y;
    let inside = x < inputs.size.x && y < inputs.size.y;
    {kernel}(select(NONE, y * inputs.size.x + x, inside), x, y, lane, inside);
    finish_counting();
}}
"
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_cover_a_picture_under_every_origin() {
        let size = [16, 12];
        for picture in [[1, 1], [16, 12], [17, 24], [100, 50]] {
            let drawn = Lanes::Tiles { size, origin: Origin::PerFrame(Purpose::TileMask) };
            let mut most = [0, 0];
            for x in 0..size[0] {
                for y in 0..size[1] {
                    let fixed = Lanes::Tiles { size, origin: Origin::Fixed([x, y]) };
                    let groups = fixed.groups(picture);
                    assert!(groups[0] * size[0] >= picture[0] + x);
                    assert!(groups[1] * size[1] >= picture[1] + y);
                    most = [most[0].max(groups[0]), most[1].max(groups[1])];
                }
            }
            assert_eq!(drawn.groups(picture), most);
        }
        assert_eq!(Lanes::Pixels.groups([17, 8]), [3, 1]);
        assert_eq!(Lanes::Items(257).groups([17, 8]), [2, 1]);
    }
}
