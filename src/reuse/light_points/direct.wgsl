// Twin of `direct`: receivers, light points, candidates, mutations, records.

struct Receiver {
    w: u32,
    surface: SurfacePoint,
    outgoing: vec3f,
}

struct Sight {
    integrand: vec3f,
    bsdf_density: f32,
    arrival: Arrival,
    valid: bool,
}

// A sight with the emitter that it is of.
struct Look {
    sight: Sight,
    emitter: EmitterPoint,
}

fn receiver_new(w: u32, hit: Hit, direction: vec3f) -> Receiver {
    let surface = surface_at(w, hit, point_at(w, hit));
    return Receiver(w, surface, to_local(surface.frame, -direction));
}

fn receiver_scatters(receiver: Receiver) -> bool {
    return !bsdf_is_black(receiver.surface.bsdf) && bsdf_has_non_delta(receiver.surface.bsdf);
}

fn receiver_sight(receiver: Receiver, emitter: EmitterPoint) -> Sight {
    var sight: Sight;
    sight.valid = false;
    sight.arrival = emitter_towards(receiver.w, emitter, receiver.surface.position);
    if !sight.arrival.valid {
        return sight;
    }
    let scattered = bsdf_evaluate(
        receiver.surface.bsdf,
        receiver.outgoing,
        to_local(receiver.surface.frame, sight.arrival.direction),
    );
    sight.integrand = scattered.value * sight.arrival.radiance;
    sight.bsdf_density = scattered.pdf * sight.arrival.geometry;
    sight.valid = !all_zero(sight.integrand);
    return sight;
}

fn receiver_look(receiver: Receiver, point: LightPoint) -> Look {
    var look: Look;
    look.emitter = light_emitter(receiver.w, point);
    look.sight.valid = false;
    if look.emitter.valid {
        look.sight = receiver_sight(receiver, look.emitter);
    }
    return look;
}

// One shadow ray.
fn receiver_sees(receiver: Receiver, direction: vec3f, emitter: EmitterPoint) -> bool {
    let end = shadow_end(receiver.w, emitter, receiver.surface.position);
    count(SHADOW_RAYS, 1u);
    return !occluded(receiver.w, shadow_ray(receiver.surface, direction, end));
}

// --- Records: a finished reservoir in six words.

struct Record {
    point: LightPoint,
    weight: f32,
    target_luminance: f32,
    packed: u32,
}

const RECORD: u32 = 6u;
const MAX_CONFIDENCE: f32 = 255.0;

fn record_empty(packed: u32) -> Record {
    return Record(LightPoint(NO_LIGHT, vec2f(0.0)), 0.0, 0.0, packed);
}

fn record_new(point: LightPoint, weight: f32, confidence: f32, target_luminance: f32, age: u32, kept: u32) -> Record {
    let packed = u32(min(confidence, MAX_CONFIDENCE)) | (min(age, 255u) << 8u) | (kept << 16u);
    if weight > 0.0 {
        return Record(point, weight, target_luminance, packed);
    }
    return record_empty(packed);
}

fn record_confidence(record: Record) -> f32 {
    return f32(record.packed & 255u);
}

fn record_age(record: Record) -> u32 {
    return (record.packed >> 8u) & 255u;
}

fn record_kept(record: Record) -> u32 {
    return record.packed >> 16u;
}

fn read_record(first: u32, pixel: u32) -> Record {
    let at = first + pixel * RECORD;
    return Record(
        LightPoint(state[at], vec2f(bitcast<f32>(state[at + 1u]), bitcast<f32>(state[at + 2u]))),
        bitcast<f32>(state[at + 3u]),
        bitcast<f32>(state[at + 4u]),
        state[at + 5u],
    );
}

fn write_record(first: u32, pixel: u32, record: Record) {
    let at = first + pixel * RECORD;
    state[at] = record.point.light;
    state[at + 1u] = bitcast<u32>(record.point.uv.x);
    state[at + 2u] = bitcast<u32>(record.point.uv.y);
    state[at + 3u] = bitcast<u32>(record.weight);
    state[at + 4u] = bitcast<u32>(record.target_luminance);
    state[at + 5u] = record.packed;
}

// --- The shift between frames.

// A light point of one world in another; the ratio of the light's areas, 0 where there is none.
struct Moved {
    point: LightPoint,
    jacobian: f32,
}

fn carried_over(point: LightPoint, from_w: u32, to_w: u32) -> Moved {
    if from_w == to_w {
        return Moved(point, 1.0);
    }
    var light = point.light;
    if inputs.remap.x != NONE {
        let first = select(inputs.remap.z, inputs.remap.x, to_w == NOW);
        let length = select(inputs.remap.w, inputs.remap.y, to_w == NOW);
        if light >= length {
            return Moved(point, 0.0);
        }
        light = words[first + light];
        if light == NO_LIGHT {
            return Moved(point, 0.0);
        }
    }
    let moved = LightPoint(light, point.uv);
    if !same_kind(to_w, light, from_w, point.light) {
        return Moved(moved, 0.0);
    }
    let jacobian = light_measure(to_w, moved) / light_measure(from_w, point);
    return Moved(moved, select(0.0, jacobian, is_finite(jacobian) && jacobian > 0.0));
}

// --- Candidates.

override CANDIDATE_LIGHTS: u32 = 8u;
override CANDIDATE_BSDF: u32 = 1u;
// Whether any emitter is a surface.
override CANDIDATE_SURFACES: bool = true;
// Number of tiles of light points, and the buffer that they lie in.
override LIGHT_TILES: u32 = 0u;
override B_TILES: u32 = 0u;

// Entries of a tile, words of an entry.
const TILE: u32 = 256u;
const TILE_ENTRY: u32 = 15u;

struct Chosen {
    point: LightPoint,
    emitter: EmitterPoint,
    sight: Sight,
    weight_sum: f32,
    valid: bool,
}

fn write_tile_entry(item: u32, emitter: EmitterPoint, uv: vec2f, density: f32) {
    let at = buffer_now(B_TILES) + item * TILE_ENTRY;
    write_vector(at, emitter.position);
    write_vector(at + 3u, emitter.normal);
    write_vector(at + 6u, emitter.radiance);
    state[at + 9u] = emitter.kind;
    state[at + 10u] = emitter.light;
    state[at + 11u] = emitter.light;
    state[at + 12u] = bitcast<u32>(uv.x);
    state[at + 13u] = bitcast<u32>(uv.y);
    state[at + 14u] = bitcast<u32>(density);
}

fn fill_tile(item: u32, draw: vec4<u32>) {
    count(TILE_ENTRIES, 1u);
    var none: EmitterPoint;
    if inputs.worlds[NOW].alias_count == 0u {
        write_tile_entry(item, none, vec2f(0.0), 0.0);
        return;
    }
    let light = choose_light(NOW, draw.x, draw.y);
    let point = LightPoint(light, vec2f(unit_float(draw.z), unit_float(draw.w)));
    let emitter = light_emitter(NOW, point);
    let density = uniform_density(NOW, point);
    if emitter.valid && density > 0.0 {
        write_tile_entry(item, emitter, point.uv, density);
    } else {
        write_tile_entry(item, none, vec2f(0.0), 0.0);
    }
}

// What is selected among a receiver's candidates.
struct Selection {
    reservoir: Reservoir,
    point: LightPoint,
    // Whether the place holds the numbers that the point is drawn with.
    drawn: bool,
    any: bool,
}

fn offer_candidate(
    s: ptr<function, Selection>,
    point: LightPoint,
    drawn: bool,
    weight: f32,
    random: ptr<function, Stream>,
) {
    var reservoir = (*s).reservoir;
    if reservoir_stream(&reservoir, weight, 0.0, vec3f(0.0), random) {
        (*s).point = point;
        (*s).drawn = drawn;
        (*s).any = true;
    }
    (*s).reservoir = reservoir;
}

// A point on an emitter that a BSDF sample's direction meets.
fn offer_met(
    receiver: Receiver,
    s: ptr<function, Selection>,
    point: LightPoint,
    shares: vec2f,
    random: ptr<function, Stream>,
) {
    let look = receiver_look(receiver, point);
    if !look.sight.valid {
        return;
    }
    var density: f32;
    if LIGHT_TILES != 0u {
        density = uniform_density(NOW, point);
    } else {
        density = light_density_towards(NOW, point, receiver.surface.position, look.sight.arrival.geometry);
    }
    let weight = luminance(look.sight.integrand) / (shares.x * density + shares.y * look.sight.bsdf_density);
    offer_candidate(s, point, false, weight, random);
}

// The chosen one of a receiver's candidates, numbered from `first`; `seeds` are its pixel's. `tile` is the first word of its tile.
fn candidates(
    receiver: Receiver,
    seeds: vec4<u32>,
    first: u32,
    rounds: u32,
    tile: u32,
    random: ptr<function, Stream>,
) -> Chosen {
    var chosen: Chosen;
    chosen.valid = false;
    if inputs.worlds[NOW].alias_count == 0u {
        return chosen;
    }
    let place = receiver.surface.position;
    let shares = vec2f(f32(CANDIDATE_LIGHTS * rounds), f32(CANDIDATE_BSDF * rounds));
    var s: Selection;
    s.reservoir = reservoir_new();
    s.any = false;
    var draw = vec4<u32>(0u);
    for (var candidate = 0u; candidate < CANDIDATE_LIGHTS * rounds; candidate++) {
        count(CANDIDATES, 1u);
        var emitter: EmitterPoint;
        var point: LightPoint;
        var known = 0.0;
        //#if LIGHT_TILES
        if LIGHT_TILES != 0u {
            let word = candidate & 3u;
            if word == 0u {
                draw = draw4(second_round(seeds, PURPOSE_PATH_SEED, first + candidate), 0u, BLOCK_LIGHT);
            }
            let w = select(select(draw.x, draw.y, word == 1u), select(draw.z, draw.w, word == 3u), word >= 2u);
            let at = tile + wide_product(w, TILE).x * TILE_ENTRY;
            known = bitcast<f32>(state[at + 14u]);
            if known == 0.0 {
                continue;
            }
            point = LightPoint(state[at + 11u], vec2f(bitcast<f32>(state[at + 12u]), bitcast<f32>(state[at + 13u])));
            emitter = EmitterPoint(
                read_vector(at),
                read_vector(at + 3u),
                read_vector(at + 6u),
                state[at + 9u],
                state[at + 10u],
                true,
            );
        }
        //#else
        if LIGHT_TILES == 0u {
            draw = draw4(second_round(seeds, PURPOSE_PATH_SEED, first + candidate), 0u, BLOCK_LIGHT);
            point.light = choose_light(NOW, draw.x, draw.y);
            point.uv = vec2f(unit_float(draw.z), unit_float(draw.w));
            emitter = light_emitter_towards(NOW, point.light, place, point.uv);
            if !emitter.valid {
                continue;
            }
        }
        //#endif
        let arrival = emitter_towards(NOW, emitter, place);
        if !arrival.valid {
            continue;
        }
        let scattered = bsdf_evaluate(
            receiver.surface.bsdf,
            receiver.outgoing,
            to_local(receiver.surface.frame, arrival.direction),
        );
        let target_luminance = luminance(scattered.value * arrival.radiance);
        if !(target_luminance > 0.0) {
            continue;
        }
        var density = known;
        if LIGHT_TILES == 0u {
            density = light_density_towards(NOW, point, place, arrival.geometry);
        }
        let weight = target_luminance / (shares.x * density + shares.y * scattered.pdf * arrival.geometry);
        offer_candidate(&s, point, LIGHT_TILES == 0u, weight, random);
    }
    for (var candidate = 0u; candidate < CANDIDATE_BSDF * rounds; candidate++) {
        let number = first + CANDIDATE_LIGHTS * rounds + candidate;
        count(CANDIDATES, 1u);
        let sample = bsdf_sample(
            receiver.surface.bsdf,
            receiver.outgoing,
            draw4(second_round(seeds, PURPOSE_PATH_SEED, number), 0u, BLOCK_SCATTER),
        );
        if !sample.valid || sample.delta {
            continue;
        }
        let direction = unit(to_world(receiver.surface.frame, sample.wi));
        //#if ENVIRONMENTS
        if ENVIRONMENTS {
            for (var i = 0u; i < inputs.worlds[NOW].environment_count; i++) {
                let environment = environment_number(NOW, i);
                let uv = environment_invert(environment, direction);
                if uv.z != 0.0 {
                    offer_met(receiver, &s, LightPoint(environment_light(environment), uv.xy), shares, random);
                }
            }
        }
        //#endif
        //#if CANDIDATE_SURFACES
        if CANDIDATE_SURFACES && inputs.worlds[NOW].emitter_nodes != NONE {
            count(EMITTER_RAYS, 1u);
            along_emitters(receiver, direction, &s, shares, random);
        }
        //#endif
    }
    count(WEIGHTS_REJECTED, s.reservoir.rejected);
    if !s.any {
        return chosen;
    }
    chosen.point = s.point;
    if s.drawn {
        chosen.point = light_point_towards(NOW, s.point.light, place, s.point.uv);
    }
    let look = receiver_look(receiver, chosen.point);
    chosen.emitter = look.emitter;
    chosen.sight = look.sight;
    chosen.weight_sum = s.reservoir.weight_sum;
    chosen.valid = look.sight.valid;
    return chosen;
}

// All points of emitting surfaces along a direction, occluded ones too.
fn along_emitters(
    receiver: Receiver,
    direction: vec3f,
    s: ptr<function, Selection>,
    shares: vec2f,
    random: ptr<function, Stream>,
) {
    let bottom = emitters_of_world(NOW);
    let ray = world_ray(Ray(surface_origin(receiver.surface, direction), direction, FAR));
    let boxes = box_ray(ray, bottom.reach);
    let triangle = triangle_ray(ray);
    var leaves = all_leaves(bottom.nodes, 0u);
    loop {
        let leaf = next_leaf(&leaves, boxes, FAR, true);
        if leaf == NONE {
            break;
        }
        let first = leaf & SLOTS;
        let leaf_end = first + ((leaf >> 29u) & 3u);
        for (var number = first; number < leaf_end; number++) {
            var member = number;
            var end = number + 1u;
            let head = geometry[bottom.slots + number * 3u];
            if (bottom.flags & 1u) != 0u && bitcast<f32>(head.w) == 3.0 {
                member = head.x;
                end = member + geometry[bottom.slots + number * 3u + 1u].x;
            }
            for (; member < end; member++) {
                let slot = bottom.slots + member * 3u;
                var hits = 1u;
                var crossing: Crossing;
                //#if QUADRICS
                var quadric: QuadricCrossings;
                //#endif
                var is_quadric = false;
                //#if QUADRICS
                if QUADRICS && (bottom.flags & 1u) != 0u {
                    let kind = bitcast<f32>(geometry[slot].w);
                    if kind != 0.0 {
                        is_quadric = true;
                        hits = 2u;
                        quadric = cross_quadric(bottom, ray, member, NONE, kind);
                    }
                }
                //#endif
                if !is_quadric {
                    crossing = cross_triangle(slot, triangle, FAR);
                    if crossing.error < 0.0 {
                        continue;
                    }
                }
                for (var i = 0u; i < hits; i++) {
                    var hit = Hit(crossing.t, crossing.u, crossing.v, member, geometry[cold_at(bottom.cold, member)].z);
                    //#if QUADRICS
                    if is_quadric {
                        let t = select(quadric.t.y, quadric.t.x, i == 0u);
                        if t < 0.0 {
                            continue;
                        }
                        let uv = select(quadric.uv.zw, quadric.uv.xy, i == 0u);
                        hit = Hit(t, uv.x, uv.y, member, quadric.instance);
                    }
                    //#endif
                    let point = point_in(NOW, bottom, hit, false);
                    let light = words[inputs.worlds[NOW].emitter_first + point.shape] + point.element;
                    offer_met(receiver, s, light_point_at(NOW, light, hit, point.position), shares, random);
                }
            }
        }
    }
}

// --- Mutations of the light point.

const LARGEST_STEP: f32 = 1.0 / 64.0;
const LOG_RATIO: f32 = 2.7725887;

fn perturbed(u: f32, random: ptr<function, Stream>) -> f32 {
    let step = LARGEST_STEP * exp(-LOG_RATIO * stream_uniform(random));
    let moved = select(u - step, u + step, stream_choose(random, 1.0, 2.0));
    let wrapped_u = moved - floor(moved);
    return select(0.0, wrapped_u, wrapped_u < 1.0);
}

struct PointState {
    point: LightPoint,
    integrand: vec3f,
    measure: f32,
    valid: bool,
}

// The state at a light point; with `asked`, only where it is seen.
fn point_state(receiver: Receiver, point: LightPoint, asked: bool) -> PointState {
    let look = receiver_look(receiver, point);
    var s = PointState(point, look.sight.integrand, 0.0, look.sight.valid);
    if !s.valid {
        return s;
    }
    if asked {
        s.valid = receiver_sees(receiver, look.sight.arrival.direction, look.emitter);
    }
    s.measure = light_measure(NOW, point);
    s.valid = s.valid && is_finite(s.measure);
    return s;
}
