//! Kernels for graphics processors as plain data: WGSL texts with the names of their files, and
//! what a kernel is put together from. Nothing here knows a device, so techniques describe their
//! kernels without the feature `gpu`.

/// A text in WGSL and the file that it stands in, which compile errors name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Module {
    /// The file's path, as [`wgsl!`](crate::wgsl!) writes it.
    pub name: &'static str,
    /// The text. Lines that begin with `//#` are directives of the composer.
    pub text: &'static str,
}

/// The module of a file, whose path is relative to the file that the macro is used in.
#[macro_export]
macro_rules! wgsl {
    ($path:literal) => {
        $crate::twin::Module { name: concat!(file!(), "/../", $path), text: include_str!($path) }
    };
}

impl Module {
    /// The file's path without steps up.
    #[must_use]
    pub fn path(&self) -> String {
        let mut parts: Vec<&str> = Vec::new();
        for part in self.name.split(['/', '\\']) {
            match part {
                ".." if parts.last().is_some_and(|last| *last != "..") => {
                    parts.pop();
                }
                _ => parts.push(part),
            }
        }
        parts.join("/")
    }
}

/// A kernel in WGSL.
///
/// The composer writes the entry point: it knows from the pass's domain how many lanes a workgroup
/// has, checks the bounds, and adds up the counters when the kernel has returned.
///
/// | domain | signature of the kernel | lanes of a workgroup |
/// |---|---|---|
/// | pixels | `fn kernel(pixel: u32, x: u32, y: u32)` | 8 × 8 |
/// | items | `fn kernel(item: u32)` | 256 |
/// | tiles | `fn kernel(pixel: u32, x: u32, y: u32, lane: u32, inside: bool)` | the tile's pixels |
///
/// A tile's kernel is called by all lanes, so that its barriers are uniform; where a lane is not
/// `inside` the picture, its pixel is none. `TILE_WIDTH`, `TILE_HEIGHT` and `TILE_LANES` are
/// constants there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Twin {
    /// The kernel's function.
    pub kernel: &'static str,
    /// What it is made of, beside the modules that all kernels share.
    pub modules: Vec<Module>,
    /// Values of pipeline-overridable constants, which a module declares; truths are 0 and 1.
    /// Directives may ask for them.
    pub constants: Vec<(&'static str, f64)>,
    /// What else directives may ask for.
    pub flags: Vec<(&'static str, f64)>,
    /// Numbers that stand in Rust alone: the composer declares each as a `const` of type `u32`, and
    /// directives may compare with its name.
    pub names: Vec<(String, u32)>,
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_module_knows_its_file() {
        let module = crate::wgsl!("math/rng.wgsl");
        assert_eq!(module.path(), "src/math/rng.wgsl");
        assert!(module.text.contains("pcg4d"));
        let up = crate::twin::Module { name: "a/b.rs/../../c\\d.rs/../e.wgsl", text: "" };
        assert_eq!(up.path(), "c/e.wgsl");
    }
}
