// Twin of `kernels.rs`.

const TRACE: u32 = 0u;
const IN_TARGET: u32 = 1u;
const BITTERLI: u32 = 2u;
const REUSE: u32 = 3u;
const WIS: u32 = 4u;
const CONTROL: u32 = 5u;

override POLICY: u32 = 1u;
override STILL: bool = false;
override CAP: f32 = 20.0;
override MAX_AGE: u32 = 0u;
override FAMILY: u32 = 5u;
override NEIGHBOURS: u32 = 1u;
override RADIUS: f32 = 16.0;
override ROUND: u32 = 0u;
override LAST: bool = true;
override DECOUPLED: bool = false;
override STEPS: u32 = 0u;
override LARGE_STEPS: f32 = 0.3;
override BOILING_LIMIT: f32 = 1.0;
override VISIBILITY_AGE: u32 = 4u;
override VISIBILITY_DISTANCE: u32 = 16u;
override ROULETTE_AFTER: u32 = 5u;
override ALL_LIGHT: bool = false;
override KEEP_NORMALS: bool = false;
// Whether the history is the reservoirs' other half.
override OWN_HISTORY: bool = false;

// Buffers, by their place in the plan.
override B_NORMALS: u32 = 0u;
override B_RESERVOIRS: u32 = 0u;
override B_HISTORY: u32 = 0u;
override B_CONTROLS: u32 = 0u;
override B_HISTORY_CONTROLS: u32 = 0u;
override B_FROM: u32 = 0u;
override B_TO: u32 = 0u;
override B_CONTROL_FROM: u32 = 0u;
override B_CONTROL_TO: u32 = 0u;

const MAX_NEIGHBOURS: u32 = 8u;
const COSINE: f32 = 0.5;
const DEPTH: f32 = 0.1;
const OTHER_PATHS: u32 = 0x80000000u;
const TILE_BLOCK: u32 = 8u;

var<private> own_receiver: Receiver;

fn stream_of(pixel: u32, purpose: u32, round_: u32) -> Stream {
    return stream_new(inputs.run, pixel, inputs.frame, purpose, round_);
}

fn primary_direction(x: u32, y: u32) -> vec3f {
    return camera_ray(inputs.camera, sample_position(inputs.frame, x, y, 0u)).direction;
}

fn receiver_of(pixel: u32) -> Receiver {
    let x = pixel % inputs.size.x;
    let y = pixel / inputs.size.x;
    return receiver_new(NOW, primary_hit(pixel), primary_direction(x, y));
}

// The first word of the tile that a pixel's block shares.
fn tile_of(x: u32, y: u32) -> u32 {
    if LIGHT_TILES == 0u {
        return 0u;
    }
    let columns = (inputs.size.x + TILE_BLOCK - 1u) / TILE_BLOCK;
    let block = y / TILE_BLOCK * columns + x / TILE_BLOCK;
    var random = stream_of(block, PURPOSE_LIGHT_TILE, 0u);
    return buffer_now(B_TILES) + stream_index(&random, LIGHT_TILES) * TILE * TILE_ENTRY;
}

fn pixel_seeds(pixel: u32) -> vec4<u32> {
    return pcg4d(vec4<u32>(inputs.run, pixel, inputs.frame));
}

fn pack_normal(normal: vec3f) -> u32 {
    let p = octahedral_encode(normal) * 32767.0;
    return (u32(i32(rounded_away(p.x))) & 0xffffu) | ((u32(i32(rounded_away(p.y))) & 0xffffu) << 16u);
}

fn unpack_normal(word: u32) -> vec3f {
    return octahedral_decode(vec2f(signed16(word & 0xffffu), signed16(word >> 16u)) / 32767.0);
}

fn read_control(first: u32, pixel: u32) -> vec2<u32> {
    return vec2<u32>(state[first + 2u * pixel], state[first + 2u * pixel + 1u]);
}

fn write_control(first: u32, pixel: u32, control: vec2<u32>) {
    state[first + 2u * pixel] = control.x;
    state[first + 2u * pixel + 1u] = control.y;
}

// Whether a light point of this frame is seen: one shadow ray, none where the integrand is 0.
fn is_seen(receiver: Receiver, point: LightPoint) -> bool {
    let look = receiver_look(receiver, point);
    if !look.sight.valid {
        count(SHADOW_RAYS_SAVED, 1u);
        return false;
    }
    return receiver_sees(receiver, look.sight.arrival.direction, look.emitter);
}

fn integrand_at(receiver: Receiver, record: Record) -> vec3f {
    if !(record.weight > 0.0) {
        return vec3f(0.0);
    }
    let look = receiver_look(receiver, record.point);
    return select(vec3f(0.0), look.sight.integrand, vec3<bool>(look.sight.valid));
}

fn is_usable(outcome: Reused) -> bool {
    return reused_usable(outcome, VISIBILITY_AGE, VISIBILITY_DISTANCE);
}

//#if KERNEL_TILES
fn light_tiles(item: u32) {
    var random = stream_of(item, PURPOSE_LIGHT_TILE, 1u);
    let a = stream_word(&random);
    let b = stream_word(&random);
    let c = stream_word(&random);
    fill_tile(item, vec4<u32>(a, b, c, stream_word(&random)));
}
//#endif

//#if KERNEL_RIS
fn ris(pixel: u32, x: u32, y: u32) {
    var sum = vec3f(0.0);
    if primary_hit(pixel).primitive != MISS {
        let receiver = receiver_of(pixel);
        if receiver_scatters(receiver) {
            let seeds = pixel_seeds(pixel);
            let each = CANDIDATE_LIGHTS + CANDIDATE_BSDF;
            for (var estimate = 0u; estimate < inputs.effort; estimate++) {
                var random = stream_of(pixel, PURPOSE_SELECTION, estimate);
                let chosen = candidates(receiver, seeds, estimate * each, 1u, tile_of(x, y), &random);
                if !chosen.valid {
                    count(SHADOW_RAYS_SAVED, 1u);
                    continue;
                }
                if receiver_sees(receiver, chosen.sight.arrival.direction, chosen.emitter) {
                    let weight = contribution_weight(chosen.weight_sum, luminance(chosen.sight.integrand), 1.0);
                    sum += finite_or_counted(chosen.sight.integrand * weight);
                }
            }
        }
    }
    write_vector(buffer_now(RADIANCE) + pixel * 3u, sum / f32(inputs.effort));
}
//#endif

//#if KERNEL_INITIAL
fn initial(pixel: u32, x: u32, y: u32) {
    var record = record_empty(0u);
    record.point.light = 0u;
    var control = vec2<u32>(0u);
    var normal = 0u;
    if primary_hit(pixel).primitive != MISS {
        let receiver = receiver_of(pixel);
        if KEEP_NORMALS {
            normal = pack_normal(receiver.surface.frame.normal);
        }
        if receiver_scatters(receiver) {
            var random = stream_of(pixel, PURPOSE_SELECTION, 0u);
            let chosen = candidates(receiver, pixel_seeds(pixel), 0u, inputs.effort, tile_of(x, y), &random);
            var target_luminance = 0.0;
            var weight = 0.0;
            if chosen.valid {
                target_luminance = luminance(chosen.sight.integrand);
                weight = contribution_weight(chosen.weight_sum, target_luminance, 1.0);
            }
            var kept = 0u;
            if POLICY != TRACE && weight > 0.0 {
                let seen = receiver_sees(receiver, chosen.sight.arrival.direction, chosen.emitter);
                if POLICY == CONTROL {
                    let shown = finite_or_counted(chosen.sight.integrand * select(0.0, weight, seen));
                    control = control_new(shown, seen);
                } else if POLICY == REUSE {
                    kept = reused_pack(reused_fresh(seen));
                } else if POLICY == WIS {
                    kept = pack_average(select(0.0, 1.0, seen));
                } else if !seen {
                    weight = 0.0;
                }
            } else if POLICY != TRACE {
                count(SHADOW_RAYS_SAVED, 1u);
            }
            record = record_new(chosen.point, weight, 1.0, target_luminance, 0u, kept);
        }
    }
    write_record(buffer_now(B_RESERVOIRS), pixel, record);
    if POLICY == CONTROL {
        write_control(buffer_now(B_CONTROLS), pixel, control);
    }
    if KEEP_NORMALS {
        state[buffer_now(B_NORMALS) + pixel] = normal;
    }
}
//#endif

//#if KERNEL_MERGE
// --- What `merge` asks of its host. Inputs are numbered from the canonical one, 0.

struct Sample {
    light: u32,
    uv: vec2f,
}

struct Carried {
    visibility: f32,
    radiance: vec3f,
}

var<private> records: array<Record, 9>;
var<private> pixels: array<u32, 9>;
var<private> distances: array<u32, 9>;
var<private> seen: array<bool, 9>;
var<private> past_receiver: Receiver;
var<private> own_control: vec2<u32>;
var<private> past_control: vec2<u32>;
var<private> own_stored: Reused;

fn input_finished(input: u32) -> Finished {
    let record = records[input];
    var confidence = record_confidence(record);
    //#if KERNEL_TEMPORAL
    if input == 1u {
        confidence = min(confidence, CAP * record_confidence(records[0]));
    }
    //#endif
    return Finished(Sample(record.point.light, record.point.uv), record.weight, confidence);
}

fn input_target(input: u32) -> f32 {
    return records[input].target_luminance;
}

fn target_of(integrand: vec3f) -> f32 {
    //#if IDENTITY
    // A stored target travels as a grey integrand, whose luminance would round.
    return integrand.x;
    //#else
    return luminance(integrand);
    //#endif
}

//#if IDENTITY
// Between a pixel and itself one frame ago, where nothing moves: the target is the stored one.
fn shift(sample: Sample, origin: u32, destination: u32) -> Shifted {
    return Shifted(sample, vec3f(records[origin].target_luminance), 1.0, true);
}
//#else
fn shift(sample: Sample, origin: u32, destination: u32) -> Shifted {
    var shifted = Shifted(sample, vec3f(0.0), 1.0, false);
    count(SHIFTS, 1u);
    var receiver = own_receiver;
    var from_w = NOW;
    //#if KERNEL_TEMPORAL
    if !STILL {
        if destination == 1u {
            receiver = past_receiver;
        } else {
            from_w = BEFORE;
        }
    }
    //#else
    if destination > 0u {
        receiver = receiver_of(pixels[destination]);
    }
    //#endif
    let moved = carried_over(LightPoint(sample.light, sample.uv), from_w, receiver.w);
    if moved.jacobian > 0.0 {
        let look = receiver_look(receiver, moved.point);
        var visible = look.sight.valid;
        //#if POLICY=1
        if visible {
            visible = receiver_sees(receiver, look.sight.arrival.direction, look.emitter);
        }
        //#endif
        if visible {
            shifted = Shifted(Sample(moved.point.light, moved.point.uv), look.sight.integrand, moved.jacobian, true);
        }
    }
    count_if(SHIFTS_FAILED, !shifted.valid);
    return shifted;
}
//#endif

//#if KERNEL_SPATIAL
fn carry(term: Term) -> Carried {
    let traced = POLICY == WIS || POLICY == CONTROL || (POLICY != IN_TARGET && DECOUPLED && LAST);
    let shows = POLICY == CONTROL || (DECOUPLED && LAST);
    var carried = Carried(0.0, vec3f(0.0));
    if POLICY == WIS {
        carried.visibility = unpack_average(record_kept(records[0]));
    }
    if term.input > 0u {
        var visible = true;
        //#if TRACED
        if traced {
            visible = is_seen(own_receiver, LightPoint(term.shifted.sample.light, term.shifted.sample.uv));
        }
        //#endif
        seen[term.input] = visible;
        carried.visibility = select(0.0, 1.0, visible);
        if shows && visible {
            carried.radiance = term.shifted.integrand * term.contribution;
        }
    }
    //#if SHOWS
    if term.input == 0u && shows {
        var visible = true;
        if POLICY == CONTROL {
            visible = control_visible(own_control);
        } else if POLICY == REUSE {
            own_stored = stored_outcome(own_stored, records[0].point);
            visible = own_stored.visible;
        } else if POLICY != IN_TARGET {
            visible = is_seen(own_receiver, records[0].point);
        }
        seen[0] = visible;
        if visible {
            carried.radiance = integrand_at(own_receiver, records[0]) * term.contribution;
        }
    }
    //#endif
    return carried;
}
//#else
fn carry(term: Term) -> Carried {
    var carried = Carried(0.0, vec3f(0.0));
    if POLICY == WIS {
        carried.visibility = unpack_average(record_kept(records[term.input]));
    }
    //#if POLICY=5
    if POLICY == CONTROL {
        var integrand = term.shifted.integrand;
        var visible = control_visible(own_control);
        if term.input == 0u {
            integrand = integrand_at(own_receiver, records[0]);
        } else {
            if STILL {
                visible = control_visible(past_control);
            } else {
                visible = is_seen(own_receiver, LightPoint(term.shifted.sample.light, term.shifted.sample.uv));
            }
            seen[1] = visible;
        }
        if visible {
            carried.radiance = integrand * term.contribution;
        }
    }
    //#endif
    return carried;
}
//#endif

// The stored outcome of the own sample, or a ray's where it may not be used.
fn stored_outcome(outcome: Reused, point: LightPoint) -> Reused {
    if is_usable(outcome) {
        return outcome;
    }
    return reused_fresh(is_seen(own_receiver, point));
}

// A record of the last frame, without its sample where that is too old.
fn aged(record: Record) -> Record {
    if MAX_AGE > 0u && record_age(record) >= MAX_AGE {
        return record_empty(record.packed);
    }
    return record;
}

// Where the last frame's records begin.
fn history_of(own: u32, with_spatial: u32) -> u32 {
    if OWN_HISTORY {
        return buffer_before(own);
    }
    return buffer_now(with_spatial);
}

// Age and visibility bits after a temporal merge.
fn inherited(source: u32, r: Reservoir) -> vec2<u32> {
    var age = record_age(records[0]);
    var kept = record_kept(records[0]);
    if source > 0u {
        age = record_age(records[1]) + 1u;
        kept = record_kept(records[1]);
        if POLICY == REUSE {
            kept = reused_pack(reused_moved(reused_unpack(kept), 1u, 0u));
        }
    }
    if POLICY == WIS {
        kept = pack_average(reservoir_visibility(r));
    }
    return vec2<u32>(age, kept);
}
//#endif

//#if KERNEL_TEMPORAL
fn temporal(pixel: u32, x: u32, y: u32) {
    merge_history(pixel, x, y);
}

fn merge_history(pixel: u32, x: u32, y: u32) {
    let at = buffer_now(B_RESERVOIRS);
    records[0] = read_record(at, pixel);
    let hit = primary_hit(pixel);
    if hit.primitive == MISS || record_confidence(records[0]) == 0.0 {
        return;
    }
    var past_pixel = pixel;
    //#if !IDENTITY
    own_receiver = receiver_new(NOW, hit, primary_direction(x, y));
    past_receiver = own_receiver;
    //#if !STILL
    past_pixel = reproject(hit, pixel, x, y);
    if past_pixel == NONE {
        count(REUSE_REJECTED, 1u);
        return;
    }
    //#endif
    //#endif
    records[1] = aged(read_record(history_of(B_RESERVOIRS, B_HISTORY), past_pixel));
    if record_confidence(records[1]) == 0.0 {
        return;
    }
    count(TEMPORAL_MERGES, 1u);
    if POLICY == CONTROL {
        own_control = read_control(buffer_now(B_CONTROLS), pixel);
        past_control = read_control(history_of(B_CONTROLS, B_HISTORY_CONTROLS), past_pixel);
        seen[1] = false;
    }
    var r = reservoir_new();
    var random = stream_of(pixel, PURPOSE_SELECTION, 1u);
    let merged = merge(FAMILY, 1u, &r, &random);
    count(WEIGHTS_REJECTED, r.rejected);
    let kept = inherited(merged.source, r);
    //#if POLICY=5
    if POLICY == CONTROL {
        var then = vec3f(0.0);
        if control_visible(past_control) {
            then = integrand_at(past_receiver, records[1]) * records[1].weight;
        }
        let own_confidence = record_confidence(records[0]);
        let capped = min(record_confidence(records[1]), CAP);
        let share = capped / (capped + own_confidence);
        let estimate = finite_or_counted(r.radiance + share * (control_estimate(past_control) - then));
        let visible = select(seen[1], control_visible(own_control), merged.source == 0u);
        write_control(buffer_now(B_CONTROLS), pixel, control_new(estimate, visible));
    }
    //#endif
    let sample = LightPoint(merged.finished.sample.light, merged.finished.sample.uv);
    write_record(at, pixel, record_new(
        sample,
        merged.finished.weight,
        merged.finished.confidence,
        merged.target_luminance,
        kept.x,
        kept.y,
    ));
}

//#if !STILL
// The pixel of the last frame that saw this surface, whose receiver `past_receiver` then is; NONE where another was.
fn reproject(hit: Hit, pixel: u32, x: u32, y: u32) -> u32 {
    if inputs.instances.y == 0u {
        return NONE;
    }
    var instance = hit.instance;
    if inputs.instances.x != NONE {
        instance = words[inputs.instances.x + instance];
    }
    if instance >= inputs.worlds[BEFORE].instances {
        return NONE;
    }
    let then = point_under(NOW, hit, placement_at(inputs.worlds[BEFORE].placements, instance));
    let p = inputs.projection;
    let local = vec3f(
        dot3(p.row_x.xyz, then) + p.row_x.w,
        dot3(p.row_y.xyz, then) + p.row_y.w,
        dot3(p.row_z.xyz, then) + p.row_z.w,
    );
    if !(local.z > 0.0) {
        return NONE;
    }
    let position = vec2f(local.x, -local.y) * (p.scale.x / local.z) + p.scale.yz;
    if !(is_finite(position.x) && is_finite(position.y)) {
        return NONE;
    }
    let moved = position - sample_position(inputs.frame, x, y, 0u);
    var random = stream_of(pixel, PURPOSE_TEMPORAL_ROUNDING, 0u);
    let u = stream_uniform(&random);
    let past = floor(vec2f(f32(x), f32(y)) + moved + vec2f(u, stream_uniform(&random)));
    let size = vec2f(inputs.size);
    if !(past.x >= 0.0 && past.y >= 0.0 && past.x < size.x && past.y < size.y) {
        return NONE;
    }
    let past_x = u32(past.x);
    let past_y = u32(past.y);
    let at = past_y * inputs.size.x + past_x;
    let past_hit = read_hit(buffer_before(HITS) + at * 5u);
    if past_hit.primitive == MISS {
        return NONE;
    }
    let normal = unpack_normal(state[buffer_before(B_NORMALS) + at]);
    let away = then - p.origin.xyz;
    let distance = sqrt(dot3(away, away));
    let fits = dot3(own_receiver.surface.frame.normal, normal) >= COSINE
        && abs(past_hit.t - distance) < DEPTH * distance;
    if !fits {
        return NONE;
    }
    let direction = camera_ray(inputs.camera_before, sample_position(inputs.frame - 1u, past_x, past_y, 0u)).direction;
    past_receiver = receiver_new(BEFORE, past_hit, direction);
    return at;
}
//#endif
//#endif

//#if KERNEL_BOILING
// A workgroup is a tile of the boiling filter.
var<workgroup> tile_sum: array<f32, TILE_LANES>;
var<workgroup> tile_count: array<u32, TILE_LANES>;

fn boiling(pixel: u32, x: u32, y: u32, lane: u32, inside: bool) {
    var record = record_empty(0u);
    if inside {
        record = read_record(buffer_now(B_RESERVOIRS), pixel);
    }
    let shown = select(0.0, record.target_luminance * record.weight, record.weight > 0.0);
    tile_sum[lane] = shown;
    tile_count[lane] = select(0u, 1u, shown > 0.0);
    workgroupBarrier();
    // Halves of the lanes, the lower one no smaller, so that any number of lanes is summed.
    for (var left = TILE_LANES; left > 1u; left = (left + 1u) / 2u) {
        let half = (left + 1u) / 2u;
        if lane + half < left {
            tile_sum[lane] += tile_sum[lane + half];
            tile_count[lane] += tile_count[lane + half];
        }
        workgroupBarrier();
    }
    let mean = tile_sum[0] / f32(max(tile_count[0], 1u));
    if inside && shown > BOILING_LIMIT * mean {
        write_record(buffer_now(B_RESERVOIRS), pixel, record_empty(record.packed));
    }
}
//#endif

//#if KERNEL_MUTATE
fn mutate(pixel: u32, x: u32, y: u32) {
    let record = read_record(buffer_now(B_RESERVOIRS), pixel);
    if primary_hit(pixel).primitive != MISS && record.weight > 0.0 {
        run_chain(pixel, record);
    }
}

fn run_chain(pixel: u32, record: Record) {
    let receiver = receiver_of(pixel);
    let start = point_state(receiver, record.point, false);
    if !start.valid {
        return;
    }
    let target_before = luminance(start.integrand);
    var current = start;
    var accepted = 0u;
    var random = stream_of(pixel, PURPOSE_MUTATION, 0u);
    for (var i = 0u; i < STEPS; i++) {
        count(MUTATIONS, 1u);
        let large = stream_choose(&random, LARGE_STEPS, 1.0);
        var proposed: LightPoint;
        if large {
            let index = stream_index(&random, NONE);
            let light = choose_light(NOW, index, stream_index(&random, NONE));
            let u = stream_uniform(&random);
            proposed = light_point_with(NOW, light, vec2f(u, stream_uniform(&random)));
        } else {
            let u = perturbed(current.point.uv.x, &random);
            proposed = light_point_with(NOW, current.point.light, vec2f(u, perturbed(current.point.uv.y, &random)));
        }
        let same = proposed.light == current.point.light && proposed.uv.x == current.point.uv.x
            && proposed.uv.y == current.point.uv.y;
        if same {
            continue;
        }
        let next = point_state(receiver, proposed, POLICY == IN_TARGET);
        if !next.valid {
            continue;
        }
        var ratio = luminance(next.integrand) / luminance(current.integrand) * (next.measure / current.measure);
        if large {
            ratio *= choice_probability(NOW, current.point.light) / choice_probability(NOW, proposed.light);
        }
        if stream_choose(&random, min(ratio, 1.0), 1.0) {
            current = next;
            accepted += 1u;
        }
    }
    count(MUTATIONS_ACCEPTED, accepted);
    if accepted == 0u {
        return;
    }
    let target_after = luminance(current.integrand);
    let weight = mutated_weight(record.weight, target_before, target_after);
    var kept = record_kept(record);
    if POLICY == REUSE || POLICY == CONTROL {
        let visible = is_seen(receiver, current.point);
        if POLICY == REUSE {
            kept = reused_pack(reused_fresh(visible));
        } else {
            let control = read_control(buffer_now(B_CONTROLS), pixel);
            write_control(buffer_now(B_CONTROLS), pixel, control_new(control_estimate(control), visible));
        }
    }
    write_record(buffer_now(B_RESERVOIRS), pixel, record_new(
        current.point,
        weight,
        record_confidence(record),
        target_after,
        record_age(record),
        kept,
    ));
}
//#endif

//#if KERNEL_SPATIAL
fn spatial(pixel: u32, x: u32, y: u32) {
    records[0] = read_record(buffer_now(B_FROM), pixel);
    if primary_hit(pixel).primitive != MISS && record_confidence(records[0]) > 0.0 {
        merge_neighbours(pixel, x, y);
    } else {
        var empty = record_empty(0u);
        empty.point.light = 0u;
        write_record(buffer_now(B_TO), pixel, empty);
        if POLICY == CONTROL {
            write_control(buffer_now(B_CONTROL_TO), pixel, vec2<u32>(0u));
        }
        if LAST {
            write_vector(buffer_now(RADIANCE) + pixel * 3u, vec3f(0.0));
        }
    }
}

fn merge_neighbours(pixel: u32, x: u32, y: u32) {
    let hit = primary_hit(pixel);
    own_receiver = receiver_new(NOW, hit, primary_direction(x, y));
    var found = 0u;
    let normal = unpack_normal(state[buffer_now(B_NORMALS) + pixel]);
    var random = stream_of(pixel, PURPOSE_NEIGHBOURS, ROUND);
    for (var i = 0u; i < NEIGHBOURS; i++) {
        let radius = RADIUS * sqrt(stream_uniform(&random));
        let sc = sin_cos_turn(stream_uniform(&random));
        let dx = i32(rounded_away(radius * sc.y));
        let dy = i32(rounded_away(radius * sc.x));
        let nx = i32(x) + dx;
        let ny = i32(y) + dy;
        if nx < 0 || ny < 0 || nx >= i32(inputs.size.x) || ny >= i32(inputs.size.y) || (dx == 0 && dy == 0) {
            count(REUSE_REJECTED, 1u);
            continue;
        }
        let at = u32(ny) * inputs.size.x + u32(nx);
        let record = read_record(buffer_now(B_FROM), at);
        let other = primary_hit(at);
        let fits = record_confidence(record) > 0.0 && other.primitive != MISS
            && abs(other.t - hit.t) < DEPTH * hit.t
            && dot3(normal, unpack_normal(state[buffer_now(B_NORMALS) + at])) >= COSINE;
        if fits {
            found += 1u;
            records[found] = record;
            pixels[found] = at;
            distances[found] = u32(max(abs(dx), abs(dy)));
            seen[found] = false;
        } else {
            count(REUSE_REJECTED, 1u);
        }
    }
    count(SPATIAL_MERGES, found);
    if POLICY == CONTROL {
        own_control = read_control(buffer_now(B_CONTROL_FROM), pixel);
    }
    own_stored = reused_unpack(record_kept(records[0]));
    var r = reservoir_new();
    var selection = stream_of(pixel, PURPOSE_SELECTION, 16u + ROUND);
    let merged = merge(FAMILY, found, &r, &selection);
    count(WEIGHTS_REJECTED, r.rejected);
    let decoupled = DECOUPLED && LAST;
    var age = record_age(records[0]);
    var kept = record_kept(records[0]);
    if merged.source > 0u {
        age = record_age(records[merged.source]);
        if POLICY == REUSE {
            if decoupled {
                kept = reused_pack(reused_fresh(seen[merged.source]));
            } else {
                let other = reused_unpack(record_kept(records[merged.source]));
                kept = reused_pack(reused_moved(other, 0u, distances[merged.source]));
            }
        }
    } else if POLICY == REUSE && decoupled {
        kept = reused_pack(own_stored);
    }
    if POLICY == WIS {
        kept = pack_average(reservoir_visibility(r));
    }
    var control = own_control;
    //#if POLICY=5
    if POLICY == CONTROL {
        var then = vec3f(0.0);
        if control_visible(own_control) {
            then = integrand_at(own_receiver, records[0]) * records[0].weight;
        }
        let share = record_confidence(records[0]) / merged.finished.confidence;
        let estimate = finite_or_counted(r.radiance + share * (control_estimate(own_control) - then));
        var visible = control_visible(own_control);
        if merged.source > 0u {
            visible = seen[merged.source];
        }
        control = control_new(estimate, visible);
    }
    //#endif
    let sample = LightPoint(merged.finished.sample.light, merged.finished.sample.uv);
    if LAST {
        var shown = select(r.radiance, control_estimate(control), vec3<bool>(POLICY == CONTROL));
        //#if !SHOWS
        let result = shade(sample, merged.finished.weight, merged.known, merged.integrand, kept);
        shown = result.radiance;
        kept = result.kept;
        //#endif
        write_vector(buffer_now(RADIANCE) + pixel * 3u, finite_or_counted(shown));
    }
    write_record(buffer_now(B_TO), pixel, record_new(
        sample,
        merged.finished.weight,
        merged.finished.confidence,
        merged.target_luminance,
        age,
        kept,
    ));
    if POLICY == CONTROL {
        write_control(buffer_now(B_CONTROL_TO), pixel, control);
    }
}
//#endif

//#if KERNEL_SHADES
struct Shown {
    radiance: vec3f,
    kept: u32,
}

// f V W of a finished reservoir at `own_receiver`.
fn shade(sample: LightPoint, weight: f32, known: bool, integrand: vec3f, kept: u32) -> Shown {
    if !(weight > 0.0) {
        count_if(SHADOW_RAYS_SAVED, POLICY != IN_TARGET && POLICY != WIS);
        return Shown(vec3f(0.0), kept);
    }
    if (POLICY == IN_TARGET || POLICY == WIS) && known {
        let visibility = select(1.0, unpack_average(kept), POLICY == WIS);
        return Shown(integrand * (visibility * weight), kept);
    }
    let look = receiver_look(own_receiver, sample);
    if !look.sight.valid {
        return Shown(vec3f(0.0), kept);
    }
    if POLICY == IN_TARGET || POLICY == WIS {
        let visibility = select(1.0, unpack_average(kept), POLICY == WIS);
        return Shown(look.sight.integrand * (visibility * weight), kept);
    }
    let outcome = reused_unpack(kept);
    var visible = outcome.visible;
    var remains = kept;
    if POLICY == REUSE && is_usable(outcome) {
        count(SHADOW_RAYS_SAVED, 1u);
    } else {
        visible = receiver_sees(own_receiver, look.sight.arrival.direction, look.emitter);
        if POLICY == REUSE {
            remains = reused_pack(reused_fresh(visible));
        }
    }
    return Shown(look.sight.integrand * (select(0.0, 1.0, visible) * weight), remains);
}
//#endif

//#if KERNEL_SHADE
fn shade_only(pixel: u32, x: u32, y: u32) {
    let record = read_record(buffer_now(B_RESERVOIRS), pixel);
    var shown = vec3f(0.0);
    if primary_hit(pixel).primitive != MISS && record_confidence(record) > 0.0 {
        //#if POLICY=5
        if POLICY == CONTROL {
            shown = control_estimate(read_control(buffer_now(B_CONTROLS), pixel));
        }
        //#else
        if POLICY != CONTROL {
            own_receiver = receiver_of(pixel);
            shown = shade(record.point, record.weight, false, vec3f(0.0), record_kept(record)).radiance;
        }
        //#endif
    }
    write_vector(buffer_now(RADIANCE) + pixel * 3u, finite_or_counted(shown));
}
//#endif

fn other_paths(pixel: u32, x: u32, y: u32) {
    let hit = primary_hit(pixel);
    var sum = vec3f(0.0);
    if hit.primitive != MISS {
        let direction = primary_direction(x, y);
        for (var sample = 0u; sample < inputs.effort; sample++) {
            let number = select(OTHER_PATHS + sample, sample, ALL_LIGHT);
            let seed = path_seed(inputs.run, pixel, inputs.frame, number);
            sum += finite_or_counted(walk(seed, direction, hit, ROULETTE_AFTER, SAMPLE_ONE, ALL_LIGHT));
        }
    }
    let mean = sum * (1.0 / f32(inputs.effort));
    let at = buffer_now(RADIANCE) + pixel * 3u;
    if ALL_LIGHT {
        write_vector(at, mean);
    } else {
        write_vector(at, read_vector(at) + mean);
    }
}
