//! Which unknowns the coordinates of a map consist of: singularities and fitted borders at integers, the rest free.

#![allow(clippy::needless_range_loop)]

use super::conjugate_field::ConjugateField;
use super::integrate::SideFit;
use super::relations::{Terms, add};
use super::seams::{Gauss, Seams};

/// A map coordinate of a vertex.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Form {
    /// A real unknown.
    Free(u32),
    /// An integer combination of integer unknowns.
    Integer(Terms),
}

/// Which unknowns stand for the coordinates of which vertex.
pub(super) struct Unknowns {
    pub forms: Vec<[Form; 2]>,
    pub inward: Vec<[i8; 2]>,
    pub fitted_sides: [bool; 4],
    pub free: usize,
    pub integers: usize,
    /// Sums of integers that have to vanish.
    pub relations: Vec<Terms>,
}

/// A border half-edge with the field's direction (0 to 3 of the combed directions) nearest to it, and the angle between.
#[derive(Clone, Copy)]
struct BorderStep {
    half_edge: usize,
    direction: u8,
    angle: f64,
    length: f64,
    /// Whether it becomes an isoline.
    fitted: bool,
}

impl BorderStep {
    /// Half-edge that ends where this one ends, seen from its triangle.
    fn head(&self) -> usize {
        self.half_edge / 3 * 3 + (self.half_edge + 1) % 3
    }

    /// Whether the same family, carried across the seams at the vertex between them, follows the next step.
    fn continues(&self, next: &Self, seams: &Seams) -> bool {
        let [before, after] = [self.head(), next.half_edge].map(|corner| seams.corner[corner].0);
        (self.direction + after + 4 - before) % 4 == next.direction
    }
}

impl Unknowns {
    pub fn new(field: &ConjugateField, seams: &Seams) -> Self {
        let count = field.mesh.points.len();
        // Numbers of free unknowns are given at the end, by `pin`.
        let mut forms = vec![[Form::Free(0), Form::Free(0)]; count];
        for (s, &v) in seams.singular.iter().enumerate() {
            forms[v as usize] = [0, 1]
                .map(|i| Form::Integer(singularity_variable(s as u32, i).map(|k| (k as u32, 1)).into_iter().collect()));
        }
        let integers = 2 * seams.singular.len().saturating_sub(1);
        let relations = vec![];
        Self { forms, inward: vec![[0; 2]; count], fitted_sides: [false; 4], free: 0, integers, relations }
    }

    /// Ties one coordinate of the vertices along each stretch of the border that `fit` admits to one integer: both where stretches meet.
    pub fn fit_border(&mut self, field: &ConjugateField, seams: &Seams, fit: SideFit) {
        let SideFit::Within(largest) = fit else { return };
        let mut steps = vec![];
        for (side, mut own) in border_sides(field, seams).into_iter().enumerate() {
            let followed = field.aligned_sides[FIELD_SIDES[side]];
            let near = own.iter().all(|s| s.angle <= largest) && own.windows(2).all(|s| s[0].continues(&s[1], seams));
            let fitted = !own.is_empty() && (followed || near);
            // A collapsed side is a point.
            own.iter_mut().for_each(|s| s.fitted = fitted && s.length > 0.0);
            self.fitted_sides[side] = own.iter().any(|s| s.fitted);
            steps.extend(own);
        }
        let count = steps.len();
        let joined = |i: usize| {
            let [last, next]: [&BorderStep; 2] = [&steps[(i + count - 1) % count], &steps[i % count]];
            last.fitted && next.fitted && last.continues(next, seams)
        };
        let start = (0..count).find(|&i| !joined(i)).unwrap_or(0);
        // The integer, as the sheet of the last triangle sees it.
        let mut value = Terms::new();
        for i in start..start + count {
            let step = &steps[i % count];
            if !step.fitted {
                continue;
            }
            if i > start && joined(i) {
                value = self.carried(value, &steps[(i - 1) % count], step, seams);
            } else {
                value = self.begun(step, field, seams);
            }
            for corner in [step.half_edge, step.head()] {
                self.tie(corner, step, &value, field, seams);
            }
        }
    }

    /// The coordinate that is constant along a step.
    fn constant(step: &BorderStep) -> usize {
        usize::from(step.direction.is_multiple_of(2))
    }

    /// The integer of a new stretch: what is known of its first vertex, or a new unknown.
    fn begun(&mut self, step: &BorderStep, field: &ConjugateField, seams: &Seams) -> Terms {
        let corner = step.half_edge;
        let (r, place) = seams.corner[corner];
        let (index, sign) = source_component(Self::constant(step), r);
        match &self.forms[field.mesh.triangles[corner / 3][corner % 3] as usize][index] {
            Form::Integer(terms) => {
                let mut value = component(&seams.translations[place as usize], Self::constant(step));
                add(&mut value, terms, sign);
                value
            }
            Form::Free(_) => {
                self.integers += 1;
                vec![(self.integers as u32 - 1, 1)]
            }
        }
    }

    /// The integer of a stretch in the sheet of the next step: the sheet may change at the vertex between the steps.
    fn carried(&self, mut value: Terms, last: &BorderStep, next: &BorderStep, seams: &Seams) -> Terms {
        let [before, after] = [last.head(), next.half_edge].map(|corner| seams.corner[corner]);
        if before == after {
            return value;
        }
        let was = Self::constant(last);
        add(&mut value, &component(&seams.translations[before.1 as usize], was), -1);
        let (index, sign) = turned_component(was, (after.0 + 4 - before.0) % 4);
        debug_assert_eq!(index, Self::constant(next));
        value.iter_mut().for_each(|t| t.1 *= sign);
        add(&mut value, &component(&seams.translations[after.1 as usize], index), 1);
        value
    }

    /// Gives the vertex at a corner of a step's triangle the integer `value` across the step.
    fn tie(&mut self, corner: usize, step: &BorderStep, value: &Terms, field: &ConjugateField, seams: &Seams) {
        let vertex = field.mesh.triangles[corner / 3][corner % 3] as usize;
        let constant = Self::constant(step);
        let (r, place) = seams.corner[corner];
        // Component `constant` of i^r z_v is sign times component `index` of z_v.
        let (index, sign) = source_component(constant, r);
        let mut terms = value.clone();
        add(&mut terms, &component(&seams.translations[place as usize], constant), -1);
        terms.iter_mut().for_each(|t| t.1 *= sign);
        match &self.forms[vertex][index] {
            Form::Free(_) => {
                // A border along direction j has the domain on its left, along direction j + 1.
                let inward = if matches!(step.direction, 1 | 2) { -1 } else { 1 };
                self.forms[vertex][index] = Form::Integer(terms);
                self.inward[vertex][index] = inward * sign as i8;
            }
            // Where the border closes on itself without a corner, or a vertex has an integer from elsewhere.
            Form::Integer(known) => {
                add(&mut terms, known, -1);
                if !terms.is_empty() {
                    self.relations.push(terms);
                }
            }
        }
    }

    /// Takes out the freedom to translate the whole map, then numbers the free unknowns.
    pub fn pin(&mut self, field: &ConjugateField, seams: &Seams) {
        if seams.singular.is_empty() {
            for i in 0..2 {
                // Without singularities there are no seams, so each coordinate is one function.
                let first = self.forms.iter().find_map(|f| match &f[i] {
                    Form::Integer(terms) => terms.first().map(|t| t.0),
                    Form::Free(_) => None,
                });
                match first {
                    Some(pinned) => self.relations.push(vec![(pinned, 1)]),
                    None => {
                        let [nu, nv] = field.mesh.cells;
                        let center = nu / 2 * (nv + 1) + nv / 2;
                        self.forms[center][i] = Form::Integer(vec![]);
                        self.inward[center][i] = 1;
                    }
                }
            }
        }
        for form in self.forms.iter_mut().flatten() {
            if let Form::Free(number) = form {
                *number = self.free as u32;
                self.free += 1;
            }
        }
    }
}

/// The integer unknown of coordinate `i` of singularity `s`; the first singularity stays at the origin.
pub(super) fn singularity_variable(s: u32, i: usize) -> Option<usize> {
    (s > 0).then(|| 2 * (s as usize - 1) + i)
}

/// Component `i` of a translation, in integer unknowns.
pub(super) fn component(translation: &[(u32, Gauss)], i: usize) -> Terms {
    let mut terms = Terms::new();
    for &(s, c) in translation {
        // (x + iy)(p + iq) = xp - yq + i (xq + yp)
        let coefficients = if i == 0 { [c[0], -c[1]] } else { [c[1], c[0]] };
        for (k, &coefficient) in coefficients.iter().enumerate() {
            if let (Some(variable), true) = (singularity_variable(s, k), coefficient != 0) {
                add(&mut terms, &[(variable as u32, coefficient)], 1);
            }
        }
    }
    terms
}

/// Component `i` of i^r z is `sign` times component `index` of z: returns (index, sign).
pub(super) fn source_component(i: usize, r: u8) -> (usize, i64) {
    match (i, r % 4) {
        (i, 0) => (i, 1),
        (i, 2) => (i, -1),
        (0, 1) => (1, -1),
        (0, _) => (1, 1),
        (_, 1) => (0, 1),
        (_, _) => (0, -1),
    }
}

/// Component `i` of z becomes, up to `sign`, component `index` of i^r z: returns (index, sign).
fn turned_component(i: usize, r: u8) -> (usize, i64) {
    let index = if r.is_multiple_of(2) { i } else { 1 - i };
    (index, source_component(index, r).1)
}

/// For each side, counter-clockwise from v = min, its number where u = min, u = max, v = min, v = max are 0 to 3.
const FIELD_SIDES: [usize; 4] = [2, 1, 3, 0];

/// The border half-edges of the sides v = min, u = max, v = max, u = min, each counter-clockwise around the domain.
fn border_sides(field: &ConjugateField, seams: &Seams) -> [Vec<BorderStep>; 4] {
    let [nu, nv] = field.mesh.cells;
    let vertex = |i: usize, j: usize| i * (nv + 1) + j;
    let starts: [Vec<usize>; 4] = [
        (0..nu).map(|i| vertex(i, 0)).collect(),
        (0..nv).map(|j| vertex(nu, j)).collect(),
        (0..nu).map(|i| vertex(nu - i, nv)).collect(),
        (0..nv).map(|j| vertex(0, nv - j)).collect(),
    ];
    starts.map(|vertices| {
        vertices
            .into_iter()
            .map(|v| {
                let h = seams.outgoing[v] as usize;
                let (t, k) = (h / 3, h % 3);
                let triangle = field.mesh.triangles[t];
                let along = field.mesh.position(triangle[(k + 1) % 3]) - field.mesh.position(triangle[k]);
                let length = along.norm();
                let cosine =
                    |j: u8| field.layout_direction(t as u32, (seams.name[t] + j) as usize).dot(&along) / length;
                let direction = (0..4).max_by(|&a, &b| cosine(a).total_cmp(&cosine(b))).expect("four directions");
                let angle = cosine(direction).clamp(-1.0, 1.0).acos();
                BorderStep { half_edge: h, direction, angle, length, fitted: false }
            })
            .collect()
    })
}
