//! What the modules look like: validity for every plan, layouts, numbers of bindings. Needs no
//! device.

use std::mem::offset_of;

use super::super::compose::Composed;
use super::super::entry::ENTRY;
use super::super::shader::{SceneConstants, wgsl};
use super::super::upload::{CameraRecord, Inputs, ProjectionRecord, WorldRecord};
use super::super::{STORAGE_BUFFERS, Shader};
use crate::frame::gpu::twins;
use crate::plan::{Domain, Filter, SceneFacts, Shot};
use crate::scene::generate;
use crate::techniques::{Entry, REGISTRY, parse};
use crate::twin::Module;
use crate::world::World;

fn parsed(source: &str) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|e| e.emit_to_string(source))?;
    validator().validate(&module).map_err(|e| e.emit_to_string(source))?;
    Ok(module)
}

/// No capability beyond what every device has.
fn validator() -> naga::valid::Validator {
    naga::valid::Validator::new(
        naga::valid::ValidationFlags::all(),
        naga::valid::Capabilities::empty(),
    )
}

/// As [`parsed`], and with the kernel's constants in their places; an error begins with the
/// module's file and line.
fn valid(composed: &Composed, constants: &[(&str, f64)]) -> Result<naga::Module, String> {
    let source = &composed.text;
    let at = |place: Option<naga::SourceLocation>, text: String| match place {
        Some(place) => format!("{}: {text}", composed.place(place.line_number as usize)),
        None => text,
    };
    let module = naga::front::wgsl::parse_str(source)
        .map_err(|e| at(e.location(source), e.emit_to_string(source)))?;
    let info = validator()
        .validate(&module)
        .map_err(|e| at(e.location(source), e.emit_to_string(source)))?;
    let constants = constants.iter().map(|(name, value)| (name.to_string(), *value)).collect();
    let entry = (naga::ShaderStage::Compute, ENTRY);
    naga::back::pipeline_constants::process_overrides(&module, &info, Some(entry), &constants)
        .map_err(|e| {
            let reasons = std::iter::successors(Some(&e as &dyn std::error::Error), |e| e.source());
            let reasons: Vec<String> = reasons.map(ToString::to_string).collect();
            format!("with its constants: {}", reasons.join(": "))
        })?;
    Ok(module)
}

/// Number of storage buffers that a module declares.
fn storage_buffers(module: &naga::Module) -> usize {
    let globals = module.global_variables.iter();
    globals.filter(|(_, v)| matches!(v.space, naga::AddressSpace::Storage { .. })).count()
}

/// Fields of a structure with their offsets, and its size.
type Layout = (Vec<(String, u32)>, u32);

fn layout(module: &naga::Module, name: &str) -> Layout {
    for (_, ty) in module.types.iter() {
        if ty.name.as_deref() == Some(name)
            && let naga::TypeInner::Struct { members, span } = &ty.inner
        {
            let field = |m: &naga::StructMember| (m.name.clone().unwrap_or_default(), m.offset);
            return (members.iter().map(field).collect(), *span);
        }
    }
    panic!("no structure is called {name}");
}

const EVERYTHING: SceneConstants = SceneConstants {
    two_level: true,
    quadrics: true,
    coverage: true,
    textures: true,
    environments: true,
    anisotropic: true,
    one_sided: true,
    materials: 0xFF,
    stack: 64,
};

const LITTLE: SceneConstants = SceneConstants {
    two_level: false,
    quadrics: false,
    coverage: false,
    textures: false,
    environments: false,
    anisotropic: false,
    one_sided: false,
    materials: 1,
    stack: 16,
};

fn facts() -> Vec<SceneFacts> {
    let scene = generate("many-lights:2000").unwrap();
    let world = World::new(scene, &Default::default()).unwrap();
    let many = SceneFacts::new(&world.scene, world.lights.counts());
    let mut few = many.clone();
    few.lights.triangles = 3;
    few.lights.quadrics = 0;
    let moving = SceneFacts {
        moving_camera: true,
        moving_lights: true,
        moving_geometry: true,
        ..few.clone()
    };
    let delta = SceneFacts { delta_lobes: true, ..many.clone() };
    let mut one = few.clone();
    one.lights.triangles = 1;
    vec![many, few, moving, delta, one]
}

fn specs() -> Vec<String> {
    REGISTRY.iter().flat_map(Entry::specs).collect()
}

/// Scenes that have one thing of all that can be left out, and such that lack one.
fn one_of_each() -> Vec<SceneConstants> {
    let mut scenes = vec![EVERYTHING, LITTLE];
    for (mut scene, value) in [(LITTLE, true), (EVERYTHING, false)].repeat(7) {
        let at = (scenes.len() - 2) / 2;
        let flag = [
            &mut scene.two_level,
            &mut scene.quadrics,
            &mut scene.coverage,
            &mut scene.textures,
            &mut scene.environments,
            &mut scene.anisotropic,
            &mut scene.one_sided,
        ]
        .into_iter()
        .nth(at);
        *flag.unwrap() = value;
        scenes.push(scene);
    }
    for kind in 0..8 {
        scenes.push(SceneConstants { materials: 1 | 1 << kind, ..LITTLE });
        scenes.push(SceneConstants { materials: 0xFF & !(1 << kind), ..EVERYTHING });
    }
    scenes
}

#[test]
fn kernels_are_valid_whatever_one_thing_a_scene_has_or_lacks() {
    let facts = &facts()[2];
    let shot =
        Shot { size: [64, 64], depth: 3, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
    for spec in ["nee", "restir-di", "restir-di:visibility=wis-cv,mutations=1"] {
        let technique = parse(spec).unwrap();
        let plan = technique.plan(facts, &shot);
        for (pass, twin) in plan.passes.iter().zip(twins(&*technique, &plan).unwrap()) {
            for scene in one_of_each() {
                let kernel = Shader::new(&twin, pass.domain, &scene);
                let composed = kernel.compose().unwrap();
                valid(&composed, &kernel.constants)
                    .unwrap_or_else(|e| panic!("`{}`, {scene:?}: {e}", twin.kernel));
            }
        }
    }
}

/// Every kernel of every plan, for scenes with everything and with little, is valid and binds no
/// more than every device can.
#[test]
fn every_kernel_of_every_plan_is_valid() {
    let mut kernels = std::collections::BTreeMap::new();
    for facts in facts() {
        for spec in specs() {
            for filter in [Filter::Point, Filter::Box] {
                let technique = parse(&spec).unwrap();
                let shot = Shot { size: [64, 64], depth: 3, filter, run: 1, effort: 1.0, fps: 30 };
                let plan = technique.plan(&facts, &shot);
                let Some(twins) = twins(&*technique, &plan) else {
                    // Those that have none yet.
                    let without = ["restir-pt", "mcmm"].iter().any(|name| spec.starts_with(name));
                    assert!(without, "{spec} has no twins");
                    continue;
                };
                for (pass, twin) in plan.passes.iter().zip(twins) {
                    for scene in [EVERYTHING, LITTLE] {
                        let kernel = Shader::new(&twin, pass.domain, &scene);
                        let composed = kernel.compose().unwrap_or_else(|e| panic!("{spec}: {e}"));
                        let text = composed.text.clone();
                        kernels.entry(text).or_insert((kernel, spec.clone(), composed));
                    }
                }
            }
        }
    }
    assert!(kernels.len() > 40, "{}", kernels.len());
    for (kernel, spec, composed) in kernels.values() {
        let Shader { name, constants, .. } = kernel;
        let module =
            valid(composed, constants).unwrap_or_else(|e| panic!("`{name}` of {spec}: {e}"));
        let [entry] = &module.entry_points[..] else { panic!("`{name}` of {spec}") };
        assert_eq!(entry.name, ENTRY);
        let bound = storage_buffers(&module);
        assert!(
            bound <= STORAGE_BUFFERS as usize,
            "`{name}` of {spec} binds {bound} storage buffers"
        );
        // A constant that no module declares would be an error of the device, later.
        for (constant, _) in constants {
            let mut known = module.overrides.iter().map(|(_, o)| o.name.as_deref());
            assert!(
                known.any(|known| known == Some(*constant)),
                "`{name}` of {spec}: no override is called {constant}"
            );
        }
    }
}

macro_rules! fields {
    ($type:ty, $($name:ident),*) => {
        (vec![$((stringify!($name).to_string(), offset_of!($type, $name) as u32)),*], size_of::<$type>() as u32)
    };
}

/// Name, what WGSL says, what Rust says.
fn layouts(source: &str) -> Vec<(&'static str, Layout, Layout)> {
    let module = parsed(source).unwrap();
    let of = |name| layout(&module, name);
    vec![
        (
            "Inputs",
            of("Inputs"),
            fields!(
                Inputs,
                run,
                frame,
                effort,
                size,
                depth,
                box_filter,
                remap,
                instances,
                srgb,
                extra_share,
                camera,
                camera_before,
                projection,
                worlds,
                buffers
            ),
        ),
        ("CameraRays", of("CameraRays"), fields!(CameraRecord, origin, corner, right, down)),
        (
            "Projection",
            of("Projection"),
            fields!(ProjectionRecord, row_x, row_y, row_z, origin, scale),
        ),
        (
            "World",
            of("World"),
            fields!(
                WorldRecord,
                placements,
                top_nodes,
                top_order,
                top_reach,
                bottom_nodes,
                bottom_slots,
                bottom_cold,
                bottom_flags,
                bottom_reach,
                instances,
                first_of_shape,
                shapes,
                lights,
                light_count,
                alias_slots,
                alias_count,
                probabilities,
                environments,
                environment_count,
                emitter_placements,
                emitter_nodes,
                emitter_slots,
                emitter_cold,
                emitter_flags,
                emitter_reach,
                emitter_first
            ),
        ),
    ]
}

/// Structures in which a field of one side stands elsewhere on the other.
fn mismatches(source: &str) -> Vec<&'static str> {
    let is_padding = |(name, _): &(String, u32)| name.starts_with("padding");
    layouts(source)
        .into_iter()
        .filter(|(_, (wgsl, wgsl_size), (rust, rust_size))| {
            let named: Vec<_> = wgsl.iter().filter(|f| !is_padding(f)).cloned().collect();
            named != *rust || wgsl_size != rust_size
        })
        .map(|(name, ..)| name)
        .collect()
}

/// The loop's own kernel.
fn plain() -> Composed {
    planted(|_| None).unwrap()
}

/// The loop's own kernel, with another text of its module where `change` gives one.
fn planted(mut change: impl FnMut(&str) -> Option<String>) -> crate::error::Result<Composed> {
    let technique = parse("nee").unwrap();
    let shot =
        Shot { size: [64, 64], depth: 3, filter: Filter::Point, run: 1, effort: 1.0, fps: 30 };
    let plan = technique.plan(&facts()[0], &shot);
    let mut twin = twins(&*technique, &plan).unwrap().swap_remove(0);
    if let Some(text) = change(twin.modules[0].text) {
        twin.modules[0].text = Box::leak(text.into_boxed_str());
    }
    Shader::new(&twin, Domain::Pixels, &EVERYTHING).compose()
}

/// The control: an error in a module's text is reported at the module's own line, by the test of
/// all modules and by a device.
#[test]
fn errors_name_a_modules_file_and_line() {
    let line = |text: &str, part: &str| {
        1 + text.lines().position(|line| line.contains(part)).unwrap_or_else(|| panic!("{part}"))
    };
    for (right, wrong, said) in [
        (
            "    let hit = camera_hit(NOW, ray);",
            "    let hit = closest_it(NOW, ray);",
            "closest_it",
        ),
        ("    count(PRIMARY_RAYS, 1u);", "    count(PRIMARY_RAYS, 1.0);", "convert"),
        ("    write_hit(pixel, hit);", "    write_hit(pixel hit);", "expected"),
    ] {
        let mut number = 0;
        let composed = planted(|text| {
            number = line(text, right);
            Some(text.replace(right, wrong))
        })
        .unwrap();
        let place = format!("src/frame/primary_hits.wgsl:{number}: ");
        let error = valid(&composed, &[]).unwrap_err();
        assert!(error.starts_with(&place) && error.contains(said), "{place}: {error}");
        let Some(gpu) = super::device() else { continue };
        let error = gpu.compile("planted", &composed, &[]).unwrap_err().to_string();
        let wanted = format!("kernel `planted`: {place}`{}`: ", wrong.trim());
        assert!(error.contains(&wanted) && error.contains(said), "{wanted}: {error}");
    }
    let directive = planted(|text| Some(format!("{text}//#if NO_SUCH\n//#endif\n")));
    let error = directive.unwrap_err().to_string();
    let number = include_str!("../../frame/primary_hits.wgsl").lines().count() + 1;
    let wanted = format!("primary_hits.wgsl:{number}: no constant or flag is called `NO_SUCH`");
    assert!(error.contains(&wanted), "{error}");
}

#[test]
fn structures_have_the_same_layout_on_both_sides() {
    assert_eq!(mismatches(&plain().text), Vec::<&str>::new());
}

/// The control: two fields of the same type change places.
#[test]
fn a_swapped_field_is_found() {
    let swapped = plain().text.replace(
        "    alias_slots: u32,\n    alias_count: u32,\n",
        "    alias_count: u32,\n    alias_slots: u32,\n",
    );
    assert_ne!(swapped, plain().text);
    assert_eq!(mismatches(&swapped), ["World"]);
}

/// The control: a ninth storage buffer is counted, and no device takes the kernel.
#[test]
fn a_ninth_storage_buffer_is_found() {
    let mut source = plain().text;
    for binding in 7..10 {
        source.push_str(&format!(
            "@group(0) @binding({binding}) var<storage, read_write> more_{binding}: array<u32>;\n"
        ));
    }
    source.push_str(
        "@compute @workgroup_size(1) fn too_many() {
            more_7[0] = words[0] + texels[0] + nodes[0].x + geometry[0].x + state[0];
            more_8[0] = 1u; more_9[0] = 1u; atomicAdd(&counters[0], 1u);
        }",
    );
    let module = parsed(&source).unwrap();
    assert_eq!(storage_buffers(&module), STORAGE_BUFFERS as usize + 1);
    let Some(gpu) = super::device() else { return };
    let layout = gpu.guarded("a kernel's bindings", || {
        let entry = |binding| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: false },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let entries: Vec<_> = (0..9).map(entry).collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries };
        let group = gpu.device().create_bind_group_layout(&descriptor);
        gpu.device().create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&group)],
            immediate_size: 0,
        })
    });
    let error = layout.unwrap_err();
    assert!(error.is_gpu() && error.to_string().contains("a kernel's bindings"), "{error}");
}

/// The public parts compile alone, with a stub of what a host brings.
#[test]
fn public_modules_compile_with_a_stub_of_a_host() {
    parsed(wgsl::RNG).unwrap();
    parsed(wgsl::VISIBILITY).unwrap();
    parsed(&format!("{}{}", wgsl::RNG, wgsl::RESAMPLING)).unwrap();
    let stub = "
    struct Sample { x: f32 }
    struct Merge { confidence: f32 }
    fn input_finished(m: ptr<function, Merge>, input: u32) -> Finished {
        return Finished(Sample(0.5), 1.0, (*m).confidence);
    }
    fn input_target(m: ptr<function, Merge>, input: u32) -> f32 { return 1.0; }
    fn shift(m: ptr<function, Merge>, sample: Sample, origin: u32, destination: u32) -> Shifted {
        return Shifted(sample, vec3f(1.0), 1.0, true);
    }
    fn target_of(integrand: vec3f) -> f32 { return integrand.x; }
    fn carry(m: ptr<function, Merge>, term: Term) -> Carried { return Carried(1.0, vec3f(0.0)); }
    @compute @workgroup_size(1)
    fn host() {
        var r = reservoir_new();
        var random = stream_from_key(vec2<u32>(1u, 2u));
        var m = Merge(1.0);
        let merged = merge(&m, FAMILY_DEFENSIVE, 2u, &r, &random);
    }";
    parsed(&[wgsl::RNG, wgsl::RESAMPLING, wgsl::MERGE, wgsl::VISIBILITY, stub].concat()).unwrap();
}

/// Directives drop what constants say, keep what is not known, and leave texts valid.
#[test]
fn directives_select_lines() {
    const TEXT: &str = "a
//#if X
b
//#else
c
//#endif
//#if Y=2|THREE
d
//#endif
//#if !X
e
//#if Z
f
//#endif
//#endif
//#region
";
    const DECLARED: &str = "override X: bool = true;\noverride Y: u32 = 1u;\noverride Z: bool = true;\nconst THREE: u32 = 3u;\n";
    let compose = |text: &'static str, pairs: &[(&str, f64)]| {
        let modules = [Module { name: "some/text.wgsl", text }];
        Composed::new(DECLARED, &modules, &pairs.iter().copied().collect())
    };
    let select = |pairs: &[(&str, f64)]| {
        let composed = compose(TEXT, pairs).unwrap();
        composed.text.lines().skip(4).collect::<Vec<_>>().concat()
    };
    assert_eq!(select(&[("X", 1.0), ("Y", 3.0)]), "abd//#region");
    assert_eq!(select(&[("X", 0.0), ("Y", 1.0), ("Z", 1.0)]), "acef//#region");
    assert_eq!(select(&[]), "abcdef//#region");
    assert_eq!(compose(TEXT, &[("X", 1.0)]).unwrap().place(6), "some/text.wgsl:3");
    assert!(compose(TEXT, &[]).unwrap().place(1).contains("the composer"));
    for (text, wanted) in [
        ("a\n//#endif\n", "some/text.wgsl:2: an #endif without an #if"),
        ("//#if X\n", "some/text.wgsl:1: an #if has no #endif"),
        ("a\n\n//#if Q\n//#endif\n", "some/text.wgsl:3: no constant or flag is called `Q`"),
        ("//#if Y=FOUR\n//#endif\n", "some/text.wgsl:1: no constant is called `FOUR`"),
    ] {
        assert_eq!(compose(text, &[]).unwrap_err(), wanted);
    }
}

/// Numbers that stand on both sides, where a part must compile alone, are the same.
#[test]
fn numbers_on_both_sides_are_the_same() {
    use crate::math::rng::Purpose;
    use crate::resampling::Family;
    let declares = |text: &str, name: &str, number: usize| {
        let line = format!("const {name}: u32 = {number}u;");
        assert!(text.lines().any(|l| l == line), "no line `{line}`");
    };
    for (number, family) in Family::ALL.iter().enumerate() {
        let name = family.name().to_uppercase().replace('-', "_");
        declares(wgsl::RESAMPLING, &format!("FAMILY_{name}"), number);
    }
    for (name, purpose) in [
        ("PATH_SEED", Purpose::PathSeed),
        ("JITTER", Purpose::Jitter),
        ("SELECTION", Purpose::Selection),
        ("TEMPORAL_ROUNDING", Purpose::TemporalRounding),
        ("NEIGHBOURS", Purpose::Neighbours),
        ("MUTATION", Purpose::Mutation),
        ("TILE_MASK", Purpose::TileMask),
        ("LIGHT_TILE", Purpose::LightTile),
        ("TAPS", Purpose::Taps),
        ("EFFORT", Purpose::Effort),
    ] {
        declares(wgsl::RNG, &format!("PURPOSE_{name}"), purpose as usize);
    }
}
