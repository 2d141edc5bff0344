// Twin of `reuse::light_points::candidates`: light points drawn afresh, and the one that is kept.

override CANDIDATE_LIGHTS: u32 = 8u;
override CANDIDATE_BSDF: u32 = 1u;
// Whether any emitter is a surface.
override CANDIDATE_SURFACES: bool = true;

struct Chosen {
    point: LightPoint,
    emitter: EmitterPoint,
    sight: Sight,
    weight_sum: f32,
    valid: bool,
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
        let geometry = look.sight.arrival.geometry;
        density = light_density_towards(NOW, point, receiver.surface.position, geometry);
    }
    // The density of both techniques together (balance heuristic).
    let mixture =
        f32(CANDIDATE_LIGHTS) * density + f32(CANDIDATE_BSDF) * look.sight.bsdf_density;
    let weight = luminance(look.sight.integrand) / mixture;
    offer_candidate(s, point, false, weight, random);
}

// The chosen one of a receiver's candidates, numbered from `first`; `seeds` are its pixel's. `tile`
// is the first word of its tile.
fn candidates(
    receiver: Receiver,
    seeds: vec4<u32>,
    first: u32,
    tile: u32,
    random: ptr<function, Stream>,
) -> Chosen {
    var chosen: Chosen;
    chosen.valid = false;
    if inputs.worlds[NOW].alias_count == 0u {
        return chosen;
    }
    let place = receiver.surface.position;
    var s: Selection;
    s.reservoir = reservoir_new();
    s.any = false;
    var draw = vec4<u32>(0u);
    for (var candidate = 0u; candidate < CANDIDATE_LIGHTS; candidate++) {
        count(CANDIDATES, 1u);
        var emitter: EmitterPoint;
        var point: LightPoint;
        var known = 0.0;
        //#if LIGHT_TILES
        if LIGHT_TILES != 0u {
            let word = candidate & 3u;
            if word == 0u {
                let seed = second_round(seeds, PURPOSE_PATH_SEED, first + candidate);
                draw = draw4(seed, 0u, BLOCK_LIGHT);
            }
            let lower = select(draw.x, draw.y, word == 1u);
            let w = select(lower, select(draw.z, draw.w, word == 3u), word >= 2u);
            let at = tile + wide_product(w, TILE).x * TILE_ENTRY;
            known = bitcast<f32>(state[at + 14u]);
            if known == 0.0 {
                continue;
            }
            let uv = vec2f(bitcast<f32>(state[at + 12u]), bitcast<f32>(state[at + 13u]));
            point = LightPoint(state[at + 11u], uv);
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
            let seed = second_round(seeds, PURPOSE_PATH_SEED, first + candidate);
            draw = draw4(seed, 0u, BLOCK_LIGHT);
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
        let mixture = f32(CANDIDATE_LIGHTS) * density
            + f32(CANDIDATE_BSDF) * scattered.pdf * arrival.geometry;
        let weight = target_luminance / mixture;
        offer_candidate(&s, point, LIGHT_TILES == 0u, weight, random);
    }
    for (var candidate = 0u; candidate < CANDIDATE_BSDF; candidate++) {
        let number = first + CANDIDATE_LIGHTS + candidate;
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
                    let point = LightPoint(environment_light(environment), uv.xy);
                    offer_met(receiver, &s, point, random);
                }
            }
        }
        //#endif
        //#if CANDIDATE_SURFACES
        if CANDIDATE_SURFACES && inputs.worlds[NOW].emitter_nodes != NONE {
            count(EMITTER_RAYS, 1u);
            along_emitters(receiver, direction, &s, random);
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
                    let instance = geometry[cold_at(bottom.cold, member)].z;
                    var hit = Hit(crossing.t, crossing.u, crossing.v, member, instance);
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
                    let first_light = words[inputs.worlds[NOW].emitter_first + point.shape];
                    let light = first_light + point.element;
                    let met = light_point_at(NOW, light, hit, point.position);
                    offer_met(receiver, s, met, random);
                }
            }
        }
    }
}
