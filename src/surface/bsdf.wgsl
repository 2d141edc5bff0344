// Twin of `surface::bsdf` and `surface::material`: lobes in the local frame, directions pointing
// away from the surface.

const DIFFUSE: u32 = 0u;
const DIFFUSE_TRANSMISSION: u32 = 1u;
const CONDUCTOR: u32 = 2u;
const DIELECTRIC: u32 = 3u;
const THIN_DIELECTRIC: u32 = 4u;
const COATED: u32 = 5u;
const METALLIC: u32 = 6u;
const MIX: u32 = 7u;

const ALL_LOBES: u32 = 0xffffffffu;

// One material's lobes. What a, b, c, s, p, q hold depends on the kind; see `part_at`.
struct Part {
    kind: u32,
    // Perfectly smooth: lobes of the interface are deltas.
    smooth_: bool,
    two_sided: bool,
    alpha: vec2f,
    a: vec3f,
    b: vec3f,
    c: vec3f,
    s: vec4f,
    eta: f32,
    p: f32,
    q: f32,
    // Rows of the table of rough reflectances, as words, and their weights.
    rows: vec4<u32>,
    weights: vec4f,
}

struct Bsdf {
    mixed: bool,
    //#if HAS_MIX
    parts: array<Part, 2>,
    //#else
    parts: array<Part, 1>,
    //#endif
    weights: vec2f,
    probabilities: vec2f,
}

struct Evaluation {
    value: vec3f,
    pdf: f32,
}

struct BsdfSample {
    wi: vec3f,
    value: vec3f,
    pdf: f32,
    eta: f32,
    delta: bool,
    transmission: bool,
    valid: bool,
}

const NO_SCATTERING: Evaluation = Evaluation(vec3f(0.0), 0.0);

fn mirrored(side: f32, v: vec3f) -> vec3f {
    return vec3f(v.x, v.y, v.z * copysign(1.0, side));
}

// --- Fresnel

// Cosine of the refracted angle; -1 under total internal reflection.
fn refracted_cosine(c: f32, eta: f32) -> f32 {
    let squared = (eta * eta - 1.0 + c * c) / (eta * eta);
    if squared > 0.0 && c > 0.0 {
        return sqrt(squared);
    }
    return -1.0;
}

fn fresnel_dielectric(c: f32, eta: f32) -> f32 {
    let t = refracted_cosine(c, eta);
    if t < 0.0 {
        return 1.0;
    }
    let s = (c - eta * t) / (c + eta * t);
    let p = (eta * c - t) / (eta * c + t);
    return 0.5 * (s * s + p * p);
}

fn fresnel_conductor(c: f32, eta: vec3f, k: vec3f) -> vec3f {
    let c2 = c * c;
    let s2 = 1.0 - c2;
    let p = (eta * eta - 1.0) + c2 - k * k;
    let q = eta * k;
    let modulus = sqrt(p * p + 4.0 * q * q);
    let large = sqrt(0.5 * (modulus + abs(p)));
    let small = q / max(large, vec3f(MIN_POSITIVE));
    let positive = p >= vec3f(0.0);
    let a = select(small, large, positive);
    let b = select(large, small, positive);
    let b2 = b * b;
    let sa = a - c;
    let sb = a + c;
    let pa = a * c - s2;
    let pb = a * c + s2;
    let rs = (sa * sa + b2) / max(sb * sb + b2, vec3f(MIN_POSITIVE));
    let rp = rs * (pa * pa + b2 * c2) / max(pb * pb + b2 * c2, vec3f(MIN_POSITIVE));
    return 0.5 * (rs + rp);
}

fn schlick_weight(c: f32) -> f32 {
    let m = clamp(1.0 - c, 0.0, 1.0);
    let m2 = m * m;
    return m2 * m2 * m;
}

// --- GGX

const SMOOTH: f32 = 1e-3;
const NARROWEST: f32 = 1e-4;

fn ggx_stretched(alpha: vec2f, w: vec3f) -> f32 {
    let s = alpha * w.xy;
    return sqrt(s.x * s.x + s.y * s.y + w.z * w.z);
}

fn ggx_density(alpha: vec2f, h: vec3f) -> f32 {
    let s = h.xy / alpha;
    let length = s.x * s.x + s.y * s.y + h.z * h.z;
    return FRAC_1_PI / (alpha.x * alpha.y * length * length);
}

// (density, value) of a reflection for F = 1.
fn ggx_reflection(alpha: vec2f, wo: vec3f, wi: vec3f, h: vec3f) -> vec2f {
    let d = 0.5 * ggx_density(alpha, h);
    let o = ggx_stretched(alpha, wo);
    let i = ggx_stretched(alpha, wi);
    return vec2f(d / (wo.z + o), d * wi.z / (o * wi.z + i * wo.z));
}

fn ggx_sample_visible(alpha: vec2f, wo: vec3f, u: vec2f) -> vec3f {
    let v = vec3f(alpha * wo.xy, wo.z) / ggx_stretched(alpha, wo);
    let sc = sin_cos_turn(u.x);
    let below = u.y * (1.0 + v.z);
    let sin_theta = sqrt(max(below * (2.0 - below), 0.0));
    let h = vec3f(sin_theta * sc.y + v.x, sin_theta * sc.x + v.y, (1.0 - below) + v.z);
    let n = vec3f(h.x * alpha.x, h.y * alpha.y, max(h.z, 0.0));
    let inverse = 1.0 / sqrt(dot3(n, n));
    if is_finite(inverse) && inverse > 0.0 {
        return n * inverse;
    }
    return vec3f(0.0, 0.0, 1.0);
}

fn reflect_at(wo: vec3f, h: vec3f) -> vec3f {
    return 2.0 * dot3(wo, h) * h - wo;
}

// Zero where the directions are opposite.
fn half_vector(wo: vec3f, wi: vec3f) -> vec3f {
    let sum = wo + wi;
    let inverse = 1.0 / sqrt(dot3(sum, sum));
    if is_finite(inverse) && inverse > 0.0 {
        return sum * inverse;
    }
    return vec3f(0.0);
}

// --- The table of rough interfaces: rows of values over the fourth root of the cosine.

const TABLE_NODES: u32 = 128u;

fn rough_reflectance(part: Part, mu: f32) -> f32 {
    let x = sqrt(sqrt(min(mu, 1.0))) * f32(TABLE_NODES - 1u);
    let cell = min(u32(x), TABLE_NODES - 2u);
    let fraction = x - f32(cell);
    var sum = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let at = part.rows[i] + cell;
        let low = float_word(at);
        sum += part.weights[i] * (low + fraction * (float_word(at + 1u) - low));
    }
    return sum;
}

// --- Materials to lobes

// A material's words: its kind, the number of its parameters, eight words of its own, four a
// parameter. A parameter is NONE and three numbers, or a texture's program and a channel (RGB: all
// three). They are evaluated in one loop, so that the interpreter of textures stands here once.
const MATERIAL_HEAD: u32 = 10u;
const PARAMETERS: u32 = 6u;
const RGB: u32 = 5u;

fn parameter_at(at: u32, uv: vec2f) -> vec3f {
    //#if TEXTURES
    if TEXTURES && words[at] != NONE {
        let rgba = texture_at(words[at], uv);
        if words[at + 1u] == RGB {
            return rgba.xyz;
        }
        return vec3f(channel_of(rgba, words[at + 1u]));
    }
    //#endif
    return vector_word(at + 1u);
}

fn albedo_of(color: vec3f) -> vec3f {
    return clamp(color, vec3f(0.0), vec3f(1.0));
}

fn share_of(number: vec3f) -> f32 {
    return clamp(number.x, 0.0, 1.0);
}

// Both roughnesses; `remap`: alpha is the root.
fn alpha_of(u: vec3f, v: vec3f, remap: u32) -> vec2f {
    let raw = max(vec2f(u.x, v.x), vec2f(0.0));
    if remap != 0u {
        return sqrt(raw);
    }
    return raw;
}

fn with_alpha(part: ptr<function, Part>, alpha: vec2f) {
    (*part).smooth_ = !(max(alpha.x, alpha.y) >= SMOOTH);
    (*part).alpha = max(alpha, vec2f(NARROWEST));
}

fn part_at(material: u32, uv: vec2f) -> Part {
    var part: Part;
    part.kind = words[material];
    part.smooth_ = true;
    part.two_sided = true;
    // Words of the kind's own.
    let own = material + 2u;
    var p: array<vec3f, PARAMETERS>;
    for (var i = 0u; i < words[material + 1u]; i++) {
        p[i] = parameter_at(material + MATERIAL_HEAD + 4u * i, uv);
    }
    switch part.kind {
        case DIFFUSE: {
            // a: albedo
            part.a = albedo_of(p[0]);
        }
        //#if HAS_DIFFUSE_TRANSMISSION
        case DIFFUSE_TRANSMISSION: {
            // a, b: albedos; p: probability of reflection
            part.a = albedo_of(p[0]);
            part.b = min(albedo_of(p[1]), vec3f(1.0) - part.a);
            let r = max3(part.a);
            let t = max3(part.b);
            part.p = 1.0;
            if r + t > 0.0 {
                part.p = r / (r + t);
            }
        }
        //#endif
        //#if HAS_CONDUCTOR
        case CONDUCTOR: {
            // a, b: index of refraction
            if words[own] == 0u {
                part.a = max(p[0], vec3f(0.0));
                part.b = max(p[1], vec3f(0.0));
            } else {
                let r = clamp(albedo_of(p[0]), vec3f(0.0), vec3f(1.0 - 0.5 * EPSILON));
                part.a = vec3f(1.0);
                part.b = 2.0 * sqrt(r / (vec3f(1.0) - r));
            }
            with_alpha(&part, alpha_of(p[2], p[3], words[own + 1u]));
        }
        //#endif
        //#if HAS_DIELECTRIC
        case DIELECTRIC: {
            part.eta = float_word(own);
            with_alpha(&part, alpha_of(p[0], p[1], words[own + 1u]));
            part.smooth_ = part.smooth_ || abs(part.eta - 1.0) < 1e-3;
        }
        //#endif
        //#if HAS_THIN_DIELECTRIC
        case THIN_DIELECTRIC: {
            part.eta = float_word(own);
        }
        //#endif
        //#if HAS_COATED
        case COATED: {
            // a: the base; p: its strength inside
            part.eta = max(float_word(own), 1.0);
            with_alpha(&part, alpha_of(p[1], p[2], words[own + 1u]));
            // Of the table: rows of the lower index, of the higher, the first row's number, the
            // weight of the higher index.
            let mean_alpha = select(sqrt(part.alpha.x * part.alpha.y), 0.0, part.smooth_);
            let x = sqrt(sqrt(min(mean_alpha, 1.0))) * f32(TABLE_NODES - 1u);
            let cell = min(u32(x), TABLE_NODES - 2u);
            let a = x - f32(cell);
            let lower = words[own + 2u];
            let higher = words[own + 3u];
            let row = min(cell - min(cell, words[own + 4u]), words[own + 6u] - 2u) * (TABLE_NODES + 1u);
            let next = row + TABLE_NODES + 1u;
            let b = float_word(own + 5u);
            part.rows = vec4<u32>(lower + row, lower + next, higher + row, higher + next);
            part.weights = vec4f((1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b);
            var mean = 0.0;
            for (var i = 0u; i < 4u; i++) {
                mean += part.weights[i] * float_word(part.rows[i] + TABLE_NODES);
            }
            let reflectance = albedo_of(p[0]);
            let passed = 1.0 - mean;
            let eta2 = part.eta * part.eta;
            let inside = 1.0 - passed / eta2;
            part.a = reflectance / (eta2 * (vec3f(1.0) - reflectance * inside));
            part.p = max3(part.a) * passed;
        }
        //#endif
        default: {
            //#if HAS_METALLIC
            // a: reflectance; b: edge; c: diffuse; s: strengths; (p, q): passed and its edge;
            // weights: transmission
            let base = albedo_of(p[0]);
            let metal = share_of(p[1]);
            let roughness = share_of(p[2]);
            let specular = share_of(p[3]);
            let tint = max(p[4], vec3f(0.0));
            let transmission = share_of(p[5]);
            let ior = float_word(own);
            part.two_sided = words[own + 1u] != 0u;
            let n = (ior - 1.0) / (ior + 1.0);
            let f0 = min(n * n * tint, vec3f(1.0)) * specular;
            let dielectric = 1.0 - metal;
            part.a = metal * base + dielectric * f0;
            part.b = metal * (vec3f(1.0) - base) + dielectric * (vec3f(specular) - f0);
            part.p = 1.0 - max3(f0);
            part.q = specular - max3(f0);
            let mean = part.p - part.q * (1.0 / 21.0);
            let below = dielectric * (1.0 - transmission) * base;
            part.c = vec3f(0.0);
            if mean > 0.0 {
                part.c = 0.996 * below / mean;
            }
            let through = dielectric * transmission * base;
            part.weights = vec4f(through, 0.0);
            part.s = vec4f(max3(part.a), max3(part.b), max3(part.c) * mean, max3(through));
            with_alpha(&part, vec2f(roughness * roughness));
            //#endif
        }
    }
    return part;
}

fn material_at(material: u32, uv: vec2f) -> Bsdf {
    var bsdf: Bsdf;
    bsdf.weights = vec2f(1.0, 0.0);
    bsdf.probabilities = vec2f(1.0, 0.0);
    //#if HAS_MIX
    bsdf.mixed = words[material] == MIX;
    for (var i = 0u; i < select(1u, 2u, bsdf.mixed); i++) {
        // A mix has its parts' places.
        bsdf.parts[i] = part_at(select(material, words[material + 2u + i], bsdf.mixed), uv);
    }
    if bsdf.mixed {
        let amount = share_of(parameter_at(material + MATERIAL_HEAD, uv));
        bsdf.weights = vec2f(1.0 - amount, amount);
        bsdf.probabilities = bsdf.weights;
        let first = part_is_black(bsdf.parts[0]);
        let second = part_is_black(bsdf.parts[1]);
        if first && !second && amount > 0.0 {
            bsdf.probabilities = vec2f(0.0, 1.0);
        } else if second && !first && amount < 1.0 {
            bsdf.probabilities = vec2f(1.0, 0.0);
        }
    }
    //#else
    bsdf.mixed = false;
    bsdf.parts[0] = part_at(material, uv);
    //#endif
    return bsdf;
}

// --- One part

fn part_count(kind: u32) -> u32 {
    if kind == DIFFUSE || kind == CONDUCTOR {
        return 1u;
    }
    return select(2u, 3u, kind == METALLIC);
}

fn part_is_delta(part: Part, lobe: u32) -> bool {
    switch part.kind {
        case CONDUCTOR, DIELECTRIC: { return part.smooth_; }
        //#if HAS_THIN_DIELECTRIC
        case THIN_DIELECTRIC: { return true; }
        //#endif
        //#if HAS_COATED
        case COATED: { return lobe == 0u && part.smooth_; }
        //#endif
        //#if HAS_METALLIC
        case METALLIC: { return lobe != 1u && part.smooth_; }
        //#endif
        default: { return false; }
    }
}

fn part_is_black(part: Part) -> bool {
    switch part.kind {
        case DIFFUSE: { return all_zero(part.a); }
        //#if HAS_DIFFUSE_TRANSMISSION
        case DIFFUSE_TRANSMISSION: { return all_zero(part.a) && all_zero(part.b); }
        //#endif
        //#if HAS_CONDUCTOR
        case CONDUCTOR: { return all_zero(part.a - vec3f(1.0)) && all_zero(part.b); }
        //#endif
        //#if HAS_COATED
        case COATED: { return all_zero(part.a) && part.eta == 1.0; }
        //#endif
        //#if HAS_METALLIC
        case METALLIC: { return part.s.x == 0.0 && part.s.y == 0.0 && part.s.z == 0.0 && part.s.w == 0.0; }
        //#endif
        default: { return false; }
    }
}

fn part_has_non_delta(part: Part) -> bool {
    switch part.kind {
        case CONDUCTOR, DIELECTRIC: { return !part.smooth_; }
        //#if HAS_THIN_DIELECTRIC
        case THIN_DIELECTRIC: { return false; }
        //#endif
        //#if HAS_METALLIC
        case METALLIC: { return !part.smooth_ || part.s.z > 0.0; }
        //#endif
        default: { return true; }
    }
}

fn coat_reflected(part: Part, mu: f32) -> f32 {
    if part.smooth_ {
        return fresnel_dielectric(mu, part.eta);
    }
    return rough_reflectance(part, mu);
}

fn coat_probability(part: Part, reflected: f32) -> f32 {
    let base = (1.0 - reflected) * part.p;
    if base > 0.0 {
        return reflected / (reflected + base);
    }
    return 1.0;
}

fn relative_index(part: Part, wo: vec3f) -> f32 {
    return select(1.0 / part.eta, part.eta, wo.z > 0.0);
}

fn reflection_probability(part: Part, wo: vec3f) -> f32 {
    let cosine = abs(wo.z);
    let eta = relative_index(part, wo);
    if part.smooth_ {
        return fresnel_dielectric(cosine, eta);
    }
    let lean = 0.5 * sqrt(part.alpha.x * part.alpha.y);
    let scale = 1.0 / sqrt(1.0 + lean * lean);
    let sine = lean * sqrt(max(1.0 - cosine * cosine, 0.0));
    let near = min(scale * (cosine + sine), 1.0);
    let far = max(scale * (cosine - sine), 0.0);
    let seen = near * fresnel_dielectric(near, eta) + far * fresnel_dielectric(far, eta);
    return clamp(seen / (near + far), 0.05, 0.95);
}

fn pane_reflectance(part: Part, wo: vec3f) -> f32 {
    let r = fresnel_dielectric(abs(wo.z), part.eta);
    return 2.0 * r / (1.0 + r);
}

fn metallic_specular(part: Part, c: f32) -> vec3f {
    return part.a + part.b * schlick_weight(c);
}

fn metallic_passed(part: Part, c: f32) -> f32 {
    return part.p - part.q * schlick_weight(c);
}

fn metallic_hidden(part: Part, wo: vec3f) -> bool {
    return !part.two_sided && wo.z <= 0.0;
}

fn metallic_probabilities(part: Part, wo: vec3f) -> vec3f {
    let w = schlick_weight(abs(wo.z));
    let passed = part.p - part.q * w;
    let specular = part.s.x + part.s.y * max(w, 0.01);
    let diffuse = part.s.z * passed;
    let transmission = part.s.w * max(passed, 0.05);
    let sum = specular + diffuse + transmission;
    if sum > 0.0 {
        return vec3f(specular, diffuse, transmission) * (1.0 / sum);
    }
    return vec3f(1.0, 0.0, 0.0);
}

fn part_probability(part: Part, lobe: u32, wo: vec3f) -> f32 {
    var first = 1.0;
    switch part.kind {
        case DIFFUSE, CONDUCTOR: { return select(0.0, 1.0, lobe == 0u); }
        //#if HAS_DIFFUSE_TRANSMISSION
        case DIFFUSE_TRANSMISSION: { first = part.p; }
        //#endif
        //#if HAS_DIELECTRIC
        case DIELECTRIC: {
            //#if HAS_DIELECTRIC
            first = reflection_probability(part, wo);
            //#endif
        }
        //#endif
        //#if HAS_THIN_DIELECTRIC
        case THIN_DIELECTRIC: { first = pane_reflectance(part, wo); }
        //#endif
        //#if HAS_COATED
        case COATED: {
            //#if HAS_COATED
            first = coat_probability(part, coat_reflected(part, abs(wo.z)));
            //#endif
        }
        //#endif
        default: {
            //#if HAS_METALLIC
            let p = metallic_probabilities(part, wo);
            return select(select(0.0, p.z, lobe == 2u), select(p.x, p.y, lobe == 1u), lobe < 2u);
            //#endif
        }
    }
    return select(1.0 - first, first, lobe == 0u);
}

fn has_lobe(lobes: u32, lobe: u32) -> bool {
    return ((lobes >> lobe) & 1u) != 0u;
}

// Sums over those of `lobes` that are not deltas.
fn part_evaluate(part: Part, wo: vec3f, wi: vec3f, lobes: u32) -> Evaluation {
    let side = wo.z * wi.z;
    switch part.kind {
        case DIFFUSE: {
            if side > 0.0 && has_lobe(lobes, 0u) {
                let pdf = abs(wi.z) * FRAC_1_PI;
                return Evaluation(part.a * pdf, pdf);
            }
            return NO_SCATTERING;
        }
        //#if HAS_DIFFUSE_TRANSMISSION
        case DIFFUSE_TRANSMISSION: {
            if side == 0.0 || !has_lobe(lobes, select(1u, 0u, side > 0.0)) {
                return NO_SCATTERING;
            }
            let cosine = abs(wi.z) * FRAC_1_PI;
            let albedo = select(part.b, part.a, side > 0.0);
            return Evaluation(albedo * cosine, select(1.0 - part.p, part.p, side > 0.0) * cosine);
        }
        //#endif
        //#if HAS_CONDUCTOR
        case CONDUCTOR: {
            if part.smooth_ || !(side > 0.0 && has_lobe(lobes, 0u)) {
                return NO_SCATTERING;
            }
            let o = mirrored(wo.z, wo);
            let i = mirrored(wo.z, wi);
            let h = half_vector(o, i);
            if all_zero(h) {
                return NO_SCATTERING;
            }
            let dv = ggx_reflection(part.alpha, o, i, h);
            let f = fresnel_conductor(min(dot3(o, h), 1.0), part.a, part.b);
            return Evaluation(f * dv.y, dv.x);
        }
        //#endif
        //#if HAS_DIELECTRIC
        case DIELECTRIC: {
            if part.smooth_ {
                return NO_SCATTERING;
            }
            let eta = relative_index(part, wo);
            let o = mirrored(wo.z, wo);
            let i = mirrored(wo.z, wi);
            if side > 0.0 && has_lobe(lobes, 0u) {
                let h = half_vector(o, i);
                if all_zero(h) {
                    return NO_SCATTERING;
                }
                let dv = ggx_reflection(part.alpha, o, i, h);
                let f = fresnel_dielectric(min(dot3(o, h), 1.0), eta);
                return Evaluation(vec3f(f * dv.y), reflection_probability(part, wo) * dv.x);
            }
            if side < 0.0 && has_lobe(lobes, 1u) {
                var h = half_vector(o, i * eta);
                if all_zero(h) {
                    return NO_SCATTERING;
                }
                if h.z < 0.0 {
                    h = -h;
                }
                let oh = dot3(o, h);
                let ih = dot3(i, h);
                if !(oh > 0.0 && ih < 0.0) {
                    return NO_SCATTERING;
                }
                let root = ih + oh / eta;
                let jacobian = -ih / (root * root);
                let dv = ggx_reflection(part.alpha, o, vec3f(i.x, i.y, -i.z), h);
                let refracted = 4.0 * oh * jacobian;
                let f = fresnel_dielectric(min(oh, 1.0), eta);
                return Evaluation(
                    vec3f((1.0 - f) * dv.y * refracted / (eta * eta)),
                    (1.0 - reflection_probability(part, wo)) * dv.x * refracted,
                );
            }
            return NO_SCATTERING;
        }
        //#endif
        //#if HAS_COATED
        case COATED: {
            if !(side > 0.0 && (lobes & 3u) != 0u) {
                return NO_SCATTERING;
            }
            let o = mirrored(wo.z, wo);
            let i = mirrored(wo.z, wi);
            let reflected = coat_reflected(part, o.z);
            let coat = coat_probability(part, reflected);
            var sum = NO_SCATTERING;
            if has_lobe(lobes, 1u) {
                let cosine = i.z * FRAC_1_PI;
                let passed = (1.0 - reflected) * (1.0 - coat_reflected(part, i.z));
                sum.value = part.a * (passed * cosine);
                sum.pdf = (1.0 - coat) * cosine;
            }
            if !part.smooth_ && has_lobe(lobes, 0u) {
                let h = half_vector(o, i);
                if !all_zero(h) {
                    let dv = ggx_reflection(part.alpha, o, i, h);
                    sum.value += vec3f(dv.y * fresnel_dielectric(min(dot3(o, h), 1.0), part.eta));
                    sum.pdf += coat * dv.x;
                }
            }
            return sum;
        }
        //#endif
        //#if HAS_METALLIC
        case METALLIC: {
            if metallic_hidden(part, wo) || side == 0.0 || (lobes & 7u) == 0u {
                return NO_SCATTERING;
            }
            let probabilities = metallic_probabilities(part, wo);
            let o = mirrored(wo.z, wo);
            let i = mirrored(wo.z, wi);
            var sum = NO_SCATTERING;
            if side < 0.0 {
                if !part.smooth_ && has_lobe(lobes, 2u) && probabilities.z > 0.0 {
                    let m = vec3f(i.x, i.y, -i.z);
                    let h = half_vector(o, m);
                    if all_zero(h) {
                        return sum;
                    }
                    let dv = ggx_reflection(part.alpha, o, m, h);
                    sum.value = part.weights.xyz * (metallic_passed(part, dot3(o, h)) * dv.y);
                    sum.pdf = probabilities.z * dv.x;
                }
                return sum;
            }
            if has_lobe(lobes, 1u) {
                let cosine = i.z * FRAC_1_PI;
                sum.value = part.c * (metallic_passed(part, o.z) * metallic_passed(part, i.z) * cosine);
                sum.pdf = probabilities.y * cosine;
            }
            if !part.smooth_ && has_lobe(lobes, 0u) {
                let h = half_vector(o, i);
                if !all_zero(h) {
                    let dv = ggx_reflection(part.alpha, o, i, h);
                    sum.value += metallic_specular(part, dot3(o, h)) * dv.y;
                    sum.pdf += probabilities.x * dv.x;
                }
            }
            return sum;
        }
        //#endif
        default: {
            return NO_SCATTERING;
        }
    }
}

// Zero where the direction leaves its lobe's hemisphere.
fn refract_at(wo: vec3f, h: vec3f, eta: f32) -> vec3f {
    let c = dot3(wo, h);
    let t = refracted_cosine(c, eta);
    if t < 0.0 {
        return vec3f(0.0);
    }
    return (c / eta - t) * h - wo / eta;
}

// The direction map of a lobe that is not a delta; zero where there is none.
fn part_direction(part: Part, lobe: u32, wo: vec3f, u: vec2f) -> vec3f {
    let front = mirrored(wo.z, wo);
    let cosine = part.kind == DIFFUSE || part.kind == DIFFUSE_TRANSMISSION
        || (lobe == 1u && (part.kind == COATED || part.kind == METALLIC));
    if part.kind == METALLIC && metallic_hidden(part, wo) {
        return vec3f(0.0);
    }
    if cosine {
        let wi = sample_cosine_hemisphere(u);
        let through = part.kind == DIFFUSE_TRANSMISSION && lobe != 0u;
        return vec3f(wi.x, wi.y, copysign(wi.z, select(wo.z, -wo.z, through)));
    }
    if part.smooth_ {
        return vec3f(0.0);
    }
    let h = ggx_sample_visible(part.alpha, front, u);
    if part.kind == DIELECTRIC && lobe == 1u {
        var wi = refract_at(front, h, relative_index(part, wo));
        if all_zero(wi) {
            return vec3f(0.0);
        }
        wi = unit(wi);
        if !(wi.z < 0.0) {
            return vec3f(0.0);
        }
        return vec3f(wi.x, wi.y, wi.z * copysign(1.0, wo.z));
    }
    let wi = reflect_at(front, h);
    if !(wi.z > 0.0) {
        return vec3f(0.0);
    }
    let through = part.kind == METALLIC && lobe == 2u;
    return vec3f(wi.x, wi.y, copysign(wi.z, select(wo.z, -wo.z, through)));
}

// The direction of a delta lobe; not valid where there is none.
fn part_delta(part: Part, lobe: u32, wo: vec3f) -> BsdfSample {
    var sample: BsdfSample;
    sample.valid = true;
    sample.delta = true;
    sample.eta = 1.0;
    sample.wi = vec3f(-wo.x, -wo.y, wo.z);
    switch part.kind {
        //#if HAS_CONDUCTOR
        case CONDUCTOR: {
            sample.value = fresnel_conductor(abs(wo.z), part.a, part.b);
            sample.pdf = 1.0;
        }
        //#endif
        //#if HAS_DIELECTRIC
        case DIELECTRIC: {
            let f = reflection_probability(part, wo);
            sample.value = vec3f(f);
            sample.pdf = f;
            if lobe != 0u {
                let eta = relative_index(part, wo);
                var wi = refract_at(mirrored(wo.z, wo), vec3f(0.0, 0.0, 1.0), eta);
                if all_zero(wi) {
                    sample.valid = false;
                    return sample;
                }
                wi = unit(wi);
                sample.wi = vec3f(wi.x, wi.y, wi.z * copysign(1.0, wo.z));
                sample.value = vec3f((1.0 - f) / (eta * eta));
                sample.pdf = 1.0 - f;
                sample.eta = eta;
            }
        }
        //#endif
        //#if HAS_THIN_DIELECTRIC
        case THIN_DIELECTRIC: {
            let pdf = part_probability(part, lobe, wo);
            sample.value = vec3f(pdf);
            sample.pdf = pdf;
            if lobe != 0u {
                sample.wi = -wo;
            }
        }
        //#endif
        //#if HAS_COATED
        case COATED: {
            let f = coat_reflected(part, abs(wo.z));
            sample.value = vec3f(f);
            sample.pdf = coat_probability(part, f);
        }
        //#endif
        default: {
            //#if HAS_METALLIC
            if metallic_hidden(part, wo) {
                sample.valid = false;
                return sample;
            }
            let probabilities = metallic_probabilities(part, wo);
            let cosine = abs(wo.z);
            if lobe == 0u {
                sample.value = metallic_specular(part, cosine);
                sample.pdf = probabilities.x;
            } else {
                sample.wi = -wo;
                sample.value = part.weights.xyz * metallic_passed(part, cosine);
                sample.pdf = probabilities.z;
            }
            //#endif
        }
    }
    return sample;
}

// --- The whole material

fn bsdf_is_black(bsdf: Bsdf) -> bool {
    //#if !HAS_MIX
    return part_is_black(bsdf.parts[0]);
    //#else
    return (bsdf.weights.x == 0.0 || part_is_black(bsdf.parts[0]))
        && (bsdf.weights.y == 0.0 || part_is_black(bsdf.parts[1]));
    //#endif
}

fn bsdf_has_non_delta(bsdf: Bsdf) -> bool {
    //#if !HAS_MIX
    return part_has_non_delta(bsdf.parts[0]);
    //#else
    return (bsdf.weights.x > 0.0 && part_has_non_delta(bsdf.parts[0]))
        || (bsdf.weights.y > 0.0 && part_has_non_delta(bsdf.parts[1]));
    //#endif
}

fn bsdf_evaluate(bsdf: Bsdf, wo: vec3f, wi: vec3f) -> Evaluation {
    //#if !HAS_MIX
    return part_evaluate(bsdf.parts[0], wo, wi, ALL_LOBES);
    //#else
    var sum = NO_SCATTERING;
    for (var i = 0u; i < 2u; i++) {
        if bsdf.weights[i] > 0.0 {
            let part = part_evaluate(bsdf.parts[i], wo, wi, ALL_LOBES);
            sum.value += bsdf.weights[i] * part.value;
            sum.pdf += bsdf.probabilities[i] * part.pdf;
        }
    }
    return sum;
    //#endif
}

// The lobe that a word chooses: its part in x, its number there in y; NONE where no lobe has light.
fn choose_lobe(bsdf: Bsdf, wo: vec3f, word: u32) -> vec2<u32> {
    var below = 0.0;
    var last = vec2<u32>(NONE, 0u);
    //#if HAS_MIX
    let parts = select(1u, 2u, bsdf.mixed);
    if parts == 1u && part_count(bsdf.parts[0].kind) == 1u {
        return vec2<u32>(0u, 0u);
    }
    for (var i = 0u; i < parts; i++) {
        let part = bsdf.parts[i];
        let share = bsdf.probabilities[i];
    //#else
        let i = 0u;
        let part = bsdf.parts[0];
        let share = 1.0;
        if part_count(part.kind) == 1u {
            return vec2<u32>(0u, 0u);
        }
    //#endif
        let lobes = part_count(part.kind);
        for (var lobe = 0u; lobe < lobes; lobe++) {
            let p = share * part_probability(part, lobe, wo);
            if p > 0.0 {
                below += p;
                last = vec2<u32>(i, lobe);
                // A sum that rounds to 1 or beyond ends the search; a word is below 2^32.
                if below >= 1.0 || word < u32(below * 4294967296.0) {
                    return last;
                }
            }
        }
    //#if HAS_MIX
    }
    //#endif
    return last;
}

fn bsdf_sample(bsdf: Bsdf, wo: vec3f, draw: vec4<u32>) -> BsdfSample {
    var none: BsdfSample;
    none.valid = false;
    if wo.z == 0.0 {
        return none;
    }
    let chosen = choose_lobe(bsdf, wo, draw.x);
    if chosen.x == NONE {
        return none;
    }
    var part = bsdf.parts[0];
    var weight = 1.0;
    var probability = 1.0;
    //#if HAS_MIX
    if bsdf.mixed {
        if chosen.x == 1u {
            part = bsdf.parts[1];
        }
        weight = bsdf.weights[chosen.x];
        probability = bsdf.probabilities[chosen.x];
    }
    //#endif
    if part_is_delta(part, chosen.y) {
        var sample = part_delta(part, chosen.y, wo);
        sample.value *= weight;
        sample.pdf *= probability;
        sample.transmission = wo.z * sample.wi.z < 0.0;
        sample.valid = sample.valid && sample.pdf > 0.0;
        return sample;
    }
    let wi = part_direction(part, chosen.y, wo, vec2f(unit_float(draw.y), unit_float(draw.z)));
    if all_zero(wi) {
        return none;
    }
    let total = bsdf_evaluate(bsdf, wo, wi);
    if !(total.pdf > 0.0) {
        return none;
    }
    var eta = 1.0;
    if part.kind == DIELECTRIC && chosen.y != 0u {
        eta = relative_index(part, wo);
    }
    return BsdfSample(wi, total.value, total.pdf, eta, false, wo.z * wi.z < 0.0, true);
}
